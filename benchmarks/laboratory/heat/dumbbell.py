"""The libration spectrum of a levitated nanodumbbell in light that is polarised along z.

Two equal spheres in touch, whose moments are as 7 : 7 : 2, in the potential V0 (1 - u_z^2 + a u_y^2) of the light; u is
the long axis, and a the small difference between the stiffness about the two short axes. The dumbbell librates about z.
The spin about its long axis, which the gas drives and the light does not hold, couples the two librations like a
gyroscope: to first order in u_x and u_y, in units of I1,

    u_x'' + G u_x' + w_x^2 u_x + l u_y' = noise,    u_y'' + G u_y' + w_y^2 u_y - l u_x' = noise,    l = I3 Omega3 / I1

with w_x = w_y the two lines are at w +- l/2. A spin changes in the time I3/G, so a spectrum is the average of such
pairs over the Maxwell distribution of the spin (W. Bang et al., Phys. Rev. Research 2 (2020) 043054; see also arXiv
2509.01636, whose measured spectrum has such shoulders).
"""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy import signal

import midlie_jax as ml
from midlie_jax._xla.compiler import compiler_options

STIFFNESS = 100.0  # V0/kT
SHARE = 2 / 7  # I3/I1
FRICTION = 1e-3  # per I1, in units of sqrt(kT/I1)
OMEGA = math.sqrt(2 * STIFFNESS)  # of libration in the plane x z, in the same units
BODIES = 4000
SAMPLES = 8192
_STEP, _EVERY = 0.1, 8  # the step in units of 1/OMEGA, and steps between samples
METHOD = "SYMMETRIC[BAOAB]"


class Spectrum(NamedTuple):
    """Attributes:
    frequency: in units of the libration frequency.
    density: of u_x, for all bodies, one-sided, per unit of this frequency; its integral is <u_x^2>.
    of_spins: the same of bodies whose spin is close to given ones, by these spins in units of their thermal size.
    """

    frequency: np.ndarray
    density: np.ndarray
    of_spins: dict[float, np.ndarray]


SPINS = 1.0, 2.0
_NEAR = 0.08


def start(difference: float, seed: int = 0) -> ml.RigidState:
    """Bodies in equilibrium: u_x and u_y are normal, with the weight 1/u_z of the sphere."""
    random = np.random.default_rng(seed)
    place = random.normal(size=(2 * BODIES, 2)) / np.sqrt(2 * STIFFNESS * np.array([1, 1 + difference]))
    weight = 1 / np.sqrt(1 - np.sum(place**2, axis=1).clip(max=0.75))
    x, y = place[random.uniform(0, 2, 2 * BODIES) < weight][:BODIES].T
    axis = np.stack([x, y, np.sqrt(1 - x * x - y * y)], axis=-1)
    # The shortest turn from z, after any turn about z.
    turn = np.stack([1 + axis[:, 2], -axis[:, 1], axis[:, 0], np.zeros(BODIES)], axis=-1)
    turn /= np.linalg.norm(turn, axis=1)[:, None]
    spin = random.uniform(0, 2 * math.pi, BODIES) / 2
    zero = np.zeros(BODIES)
    attitude = ml.so3.multiply(jnp.asarray(turn), jnp.asarray(np.stack([np.cos(spin), zero, zero, np.sin(spin)], -1)))
    momentum = random.normal(size=(BODIES, 3)) * np.sqrt([1, 1, SHARE])
    return ml.RigidState(jnp.asarray(momentum, jnp.float32), attitude.astype(jnp.float32))


def axis(state: ml.RigidState) -> tuple[Any, Any]:
    """u_x and u_y."""
    a, b, c, d = (state.attitude[..., i] for i in range(4))
    return 2 * (b * d + a * c), 2 * (c * d - a * b)


def spectrum(difference: float, seed: int = 1) -> Spectrum:
    """That of a run of all bodies."""

    def light(t: Any, state: ml.RigidState) -> Any:
        del t
        x, y = axis(state)
        return STIFFNESS * (x * x + (1 + difference) * y * y)

    def observed(t: Any, state: ml.RigidState) -> Any:
        del t
        return jnp.stack([axis(state)[0], state.momentum[2]])

    def run(begin: ml.RigidState, keys: Any) -> Any:
        body = ml.RigidBody(jnp.asarray([1, 1, SHARE], jnp.float32))
        gas = ml.torques.Langevin(jnp.float32(1), jnp.float32(FRICTION), keys)
        torque = ml.torques.FromPotential(light) + gas
        options: Any = {"dt": jnp.float32(_STEP / OMEGA), "steps": SAMPLES * _EVERY, "save_every": _EVERY}
        return ml.ensemble(METHOD, body, torque, begin, **options, observe=observed).states

    keys = jax.random.split(jax.random.key(seed), BODIES)
    program = jax.jit(run, compiler_options=compiler_options(BODIES))
    values = np.asarray(program(start(difference, seed), keys))[:, :SAMPLES]
    spins = np.abs(values[:, :, 1]).mean(axis=1) / math.sqrt(SHARE)
    # Times are in units of 1/OMEGA, and OMEGA is at the frequency 1.
    rate = 2 * math.pi / (_STEP * _EVERY)
    frequency, each = signal.welch(values[:, :, 0], rate, nperseg=SAMPLES, detrend=False)
    near = {spin: each[np.abs(spins - spin) < _NEAR].mean(axis=0) for spin in SPINS}
    return Spectrum(frequency, each.mean(axis=0), near)


def predicted(frequency: np.ndarray, spins: np.ndarray, difference: float) -> np.ndarray:
    """The density of u_x for the linear equations above, averaged over these spins, in units of their thermal size."""
    w = frequency[:, None]
    coupling = math.sqrt(SHARE) * spins / OMEGA
    friction, both = FRICTION / OMEGA, w * coupling
    x, y = (square - w * w + 1j * friction * w for square in (1, 1 + difference))
    shape = (np.abs(y) ** 2 + both**2) / np.abs(x * y - both**2) ** 2
    noise = 4 * friction / OMEGA**2 / (2 * math.pi)  # kT = I1 = 1
    return noise * shape.mean(axis=1)


def smoothed(frequency: np.ndarray, spins: np.ndarray, difference: float) -> np.ndarray:
    """`predicted`, as a spectrum shows it that is made with Hann's window of all samples."""
    fine, width = 16, 4
    spacing = frequency[1] - frequency[0]
    offsets = np.arange(-width * fine, width * fine + 1) / fine
    with np.errstate(divide="ignore", invalid="ignore"):
        kernel = np.where(np.abs(np.abs(offsets) - 1) < 1e-9, 0.5, np.sinc(offsets) / (1 - offsets**2)) ** 2
    grid = frequency[0] + spacing * np.arange(-width * fine, (len(frequency) - 1 + width) * fine + 1) / fine
    density = np.concatenate([predicted(part, spins, difference) for part in np.array_split(grid, len(grid) // 64 + 1)])
    return np.convolve(density, kernel / kernel.sum(), mode="valid")[::fine]


def thermal_spins(count: int = 4001) -> np.ndarray:
    """Equally probable spins of the Maxwell distribution about one axis."""
    from scipy.stats import norm

    return norm.ppf((np.arange(count) + 0.5) / count)
