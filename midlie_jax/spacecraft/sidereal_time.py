"""`gmst`: the angle of the Earth at an epoch."""

import math
from datetime import UTC, date, datetime
from typing import Any

from .._checks.arguments import shown
from .attitudes.epochs import Epoch

_DAY = 86400
_J2000 = date(2000, 1, 1).toordinal()  # its noon is the Julian date below
_JULIAN_OF_J2000 = 2451545.0
_YEARS = 200  # around 2000 in which a Julian date is accepted


def gmst(epoch: Any) -> float:
    """Greenwich mean sidereal time: the angle from the mean equinox to the Greenwich meridian, radians, in [0, 2 pi).

    Rotate the moment of a `midlie_jax.orbits.DipoleField` by this angle about z to start a run at the epoch. The IAU
    formula of 1982 (S. Aoki and others, Astron. Astrophys. 105 (1982) 359) is a function of UT1. UTC, which differs by
    at most 0.9 s, gives the angle to 7e-5 rad.

    Args:
        epoch: UT1 or UTC, as text such as "2026-04-13T21:45:00.5", a `datetime`, or a Julian date (a float, whose
            rounding is 3e-9 rad).

    Raises:
        ValueError: text of another form, a date that does not exist, or a Julian date before 1800 or after 2200, such
            as a modified Julian date.

    Examples:
        >>> round(float(np.degrees(ml.spacecraft.gmst("1992-08-20T12:14:00"))), 6)  # Vallado (2013), example 3-5
        152.578788
    """
    days, seconds = _since_j2000(epoch)
    centuries = (days + seconds / _DAY) / 36525
    # 876600 h per century are whole rotations for whole days, and the seconds of the day remain.
    drift = 8640184.812866 * centuries + 0.093104 * centuries**2 - 6.2e-6 * centuries**3
    rotation = _DAY * math.fmod(days, 1) + seconds
    return math.fmod(math.fmod(67310.54841 + rotation + drift, _DAY) + _DAY, _DAY) * math.tau / _DAY


def _since_j2000(epoch: Any) -> tuple[float, float]:
    """Days, and seconds, whose sum is the time since the noon of 2000-01-01."""
    if isinstance(epoch, int | float) and not isinstance(epoch, bool):
        days = float(epoch) - _JULIAN_OF_J2000
        if not abs(days) <= _YEARS * 365.25:
            problem = f"must be a Julian date from 1800 to 2200, got {shown(epoch)}"
            raise ValueError(f"epoch {problem}; add 2400000.5 to a modified one.")
        return days, 0.0
    if isinstance(epoch, datetime) and epoch.tzinfo is not None:
        epoch = epoch.astimezone(UTC).replace(tzinfo=None)
    try:
        seconds = Epoch.of("UT1", epoch).seconds - _DAY * _J2000
    except ValueError as error:
        raise ValueError(f"epoch {error}") from None
    day, rest = divmod(seconds, _DAY)
    return float(day), float(rest) - _DAY / 2
