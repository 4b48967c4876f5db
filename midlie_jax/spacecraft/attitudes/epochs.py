"""Epochs such as 2026-04-13T21:45:00.5, and the exact seconds between them, with the leap seconds of UTC."""

import re
from bisect import bisect_right
from datetime import UTC, date, datetime
from fractions import Fraction
from typing import Any, NamedTuple

from ..._checks.arguments import shown, unknown

TIME_SYSTEMS = ("UTC", "TAI", "GPS", "TT", "TDB", "TCB", "TCG", "UT1")  # time systems whose epochs are dates
_DAY = 86400
# Years whose January or July begins after a leap second, by the Bulletins C of the IERS.
_JANUARY = (*range(1973, 1981), 1988, 1990, 1991, 1996, 1999, 2006, 2009, 2017)
_JULY = (1972, 1981, 1982, 1983, 1985, 1992, 1993, 1994, 1997, 2012, 2015)
_LEAPS = sorted(date(year, month, 1).toordinal() for month, years in ((1, _JANUARY), (7, _JULY)) for year in years)
_UNIFORM_SINCE = date(1972, 1, 1).toordinal()  # before, a second of UTC was not one of atomic time
_EPOCH = re.compile(r"(\d{4})-(?:(\d{3})|(\d{2})-(\d{2}))T(\d{2}):(\d{2}):(\d{2})(?:\.(\d*))?(Z?)")


class Epoch(NamedTuple):
    """A time in one time system."""

    system: str  # one of `TIME_SYSTEMS`
    seconds: Fraction  # since the start of the calendar, with the leap seconds of UTC

    @classmethod
    def of(cls, system: str, value: Any) -> "Epoch":
        """The epoch of a text or a `datetime`; otherwise a ValueError that begins with "must"."""
        if isinstance(value, datetime):
            if value.tzinfo is not None and system != "UTC":
                raise ValueError(f"must have no time zone, because it is in {system}, got {value}.")
            value = (value if value.tzinfo is None else value.astimezone(UTC)).replace(tzinfo=None).isoformat()
        found = _EPOCH.fullmatch(value) if isinstance(value, str) else None
        if found is None:
            raise ValueError(
                f"must be an epoch such as 2026-04-13T21:45:00.5 or 2026-103T21:45:00, got {shown(value)}."
            )
        year, of_year, month, day, hour, minute, second, fraction, _ = found.groups()
        try:
            if of_year:
                ordinal = date(int(year), 1, 1).toordinal() + int(of_year) - 1
                if int(of_year) < 1 or date.fromordinal(ordinal).year != int(year):
                    raise ValueError("no such day of the year")
            else:
                ordinal = date(int(year), int(month), int(day)).toordinal()
        except ValueError as error:
            raise ValueError(f"must be an existing date, got {value!r}: {error}.") from None
        leap = system == "UTC" and (hour, minute) == ("23", "59") and ordinal + 1 in _LEAPS
        if int(hour) > 23 or int(minute) > 59 or int(second) > 59 + leap:
            raise ValueError(f"must be an existing time of day, got {value!r}.")
        if system == "UTC" and ordinal < _UNIFORM_SINCE:
            raise ValueError(f"must not be before 1972 in UTC, whose seconds varied in length, got {value!r}.")
        of_day = 3600 * int(hour) + 60 * int(minute) + int(second) + Fraction(f"0.{fraction or 0}")
        return cls(system, _start(system, ordinal) + of_day)

    def text(self, digits: int = 9) -> str:
        """The epoch as a date and time with this many digits of a second, rounded to nearest."""
        unit = 10**digits
        ticks = round(self.seconds * unit)
        day = ticks // unit // _DAY
        while ticks < unit * _start(self.system, day):
            day -= 1
        second, ticks = divmod(ticks - unit * _start(self.system, day), unit)
        hour = min(second // 3600, 23)  # a leap second belongs to the last minute
        minute = min((second - 3600 * hour) // 60, 59)
        rest = second - 3600 * hour - 60 * minute
        fraction = f".{ticks:0{digits}}" if digits else ""
        return f"{date.fromordinal(day).isoformat()}T{hour:02}:{minute:02}:{rest:02}{fraction}"


def _start(system: str, ordinal: int) -> int:
    return _DAY * ordinal + (bisect_right(_LEAPS, ordinal) if system == "UTC" else 0)


def check_system(name: Any) -> str:
    """The name of a time system, in capitals."""
    if not isinstance(name, str) or name.upper() not in TIME_SYSTEMS:
        raise unknown("time system", name, TIME_SYSTEMS, note="Times of other systems are not dates.")
    return name.upper()
