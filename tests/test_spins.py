"""Spins: orders, what each method keeps, reversal, splits, symmetries, closed forms, and what is refused."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cases import DTYPES, epsilon, refused
from scipy.integrate import solve_ivp
from scipy.linalg import block_diag

import midlie_jax as ml
from midlie_jax.integrators.registry import entries

METHODS = [e.method.name for e in entries().values() if e.method.bodies is ml.spins.Spins and not e.method.random]
# One of first order, a table of kicks and flights of order 6, of which spins see 4, and one that begins with a flight.
MORE = [f"SUBLATTICES[{name}]" for name in ("E1", "BM4", "SRKN11b")]
STEPS = 32


def random_spins(shape, seed=1, dtype="float64"):
    drawn = np.random.default_rng(seed).normal(size=(*shape, 3))
    return (drawn / np.linalg.norm(drawn, axis=-1, keepdims=True)).astype(dtype)


EXCHANGE, VECTORS = np.array([0.9, -0.6]), np.array([[0.3, 0.1, -0.2], [0.0, 0.4, 0.2]])
EASY = np.array([0.6, 0.0, 0.8])


def shaken(t, np=jnp):
    return np.stack([0.3 + 0 * t, 0.5 * np.sin(2 * t), 0.4 * np.cos(t)])


def field_numpy(t, s):
    """Exchange, Dzyaloshinskii-Moriya, anisotropy and a field that changes in time, on a lattice of two dimensions."""
    total = shaken(t, np) + 2 * 0.35 * (s @ EASY)[..., None] * EASY
    for axis, closes in enumerate((True, False)):
        after, before = np.roll(s, -1, axis), np.roll(s, 1, axis)
        if not closes:
            after[:, -1] = before[:, 0] = 0
        total = total + EXCHANGE[axis] * (after + before) + np.cross(VECTORS[axis], after - before)
    return total


def everything(dtype="float64"):
    cast, periodic = partial(jnp.asarray, dtype=dtype), (True, False)
    neighbourly = ml.spins.Exchange(cast(EXCHANGE), periodic) + ml.spins.DzyaloshinskiiMoriya(cast(VECTORS), periodic)
    return neighbourly + ml.spins.Anisotropy(cast(0.35), cast(EASY)) + ml.spins.AppliedField(shaken)


def motion_numpy(start, end, damping, field=field_numpy):
    """The spins at a time, by SciPy."""
    g = 1 / (1 + damping**2)

    def rate(t, flat):
        s = flat.reshape(start.shape)
        turn = np.cross(field(t, s), s)
        return (g * (turn + damping * np.cross(s, turn))).ravel()

    found = solve_ivp(rate, (0, end), start.ravel(), method="DOP853", rtol=1e-13, atol=1e-13)
    return found.y[:, -1].reshape(start.shape)


def run(name, damping, torque, spin, dt, steps=STEPS, save_every=None, first=0):
    damping = jnp.asarray(damping, spin.dtype) if damping else 0.0
    spins, start = ml.spins.Spins(damping, jnp.ones((), spin.dtype)), ml.spins.SpinState(jnp.asarray(spin))
    dt = jnp.asarray(dt, spin.dtype)
    return ml.integrate(name, spins, torque, start, dt=dt, steps=steps, save_every=save_every, first_step=first)


@pytest.mark.parametrize("name", [*METHODS, *MORE])
def test_order(name):
    method = ml.method(name)
    start, end = random_spins((4, 3)), 1.6
    true = motion_numpy(start, end, 0.2)
    counts = np.array([8, 16]) * {1: 16, 2: 8, 4: 2, 6: 1}[method.order]
    runs = [run(name, 0.2, everything(), start, end / count, int(count)) for count in counts]
    assert all(found.ok for found in runs)
    errors = [np.abs(found.states.spin - true).max() for found in runs]
    assert abs(np.log2(errors[0] / errors[1]) - method.order) < 0.35, errors


@pytest.mark.parametrize(("name", "dtype"), [*zip([*METHODS, MORE[2]], DTYPES * 3, strict=True)])
def test_symmetric_methods_come_back(name, dtype):
    start = random_spins((4, 3), dtype=dtype)
    there = run(name, 0.2, everything(dtype), start, 0.05)
    back = run(name, 0.2, everything(dtype), np.asarray(there.states.spin), -0.05, first=-STEPS)
    assert there.ok
    assert back.ok
    assert np.abs(there.states.spin - start).max() > 0.1
    assert np.abs(back.states.spin - start).max() < 400 * epsilon(dtype)


@pytest.mark.parametrize("name", METHODS)
def test_lengths_and_what_is_kept_under_exchange(name):
    """Turns of sublattices keep the energy, the spherical midpoint rule the sum of the spins; both to rounding."""
    start, exchange = random_spins((4, 6)), ml.spins.Exchange(-1.0)
    path = run(name, 0.0, exchange, start, 0.1, 4 * STEPS, save_every=STEPS)
    assert path.ok
    assert np.abs(np.linalg.norm(path.states.spin, axis=-1) - 1).max() < 1e-13
    energies = ml.observe.energy(ml.spins.Spins(), exchange, path)
    total = np.asarray(path.states.spin).sum(axis=(1, 2))
    changes = np.abs(energies - energies[0]).max(), np.abs(total - total[0]).max()
    kept = [change < 1e-12 for change in changes]
    assert kept == [name.startswith("SUBLATTICES"), name == "spherical midpoint"], changes


@pytest.mark.parametrize("name", ["spherical midpoint", "Lie midpoint of spins", "SUBLATTICES[EA]"])
def test_which_methods_are_symplectic(name):
    """M^T Omega(S1) M = Omega(S0) on the planes at right angles to the spins, with Omega(u, v) = S . (u x v)."""
    start = jnp.asarray(random_spins((3,)))
    torque = ml.spins.Exchange(1.0, periodic=False)

    def step(spin):
        state = ml.spins.SpinState.unchecked(spin=spin)
        return ml.integrate(name, ml.spins.Spins(), torque, state, dt=0.6, steps=1, save_every=None).states.spin

    def basis(spin):
        frames = np.linalg.svd(np.asarray(spin)[..., None])[0]  # the first column is along the spin
        return np.asarray(block_diag(*frames[:, :, 1:])).reshape(3, 3, 6)

    def area(spin, vectors):
        crossed = np.cross(vectors[:, :, :, None], vectors[:, :, None, :], axis=1)
        return np.einsum("ic,icab->ab", np.asarray(spin), crossed)

    moved = np.einsum("icjd,jda->ica", np.asarray(jax.jacfwd(step)(start)), basis(start))
    defect = np.abs(area(step(start), moved) - area(start, basis(start))).max()
    assert (defect < 1e-13) == ml.method(name).symplectic, defect
    assert defect < 1e-13 or defect > 1e-8


def test_spins_on_a_graph_of_three_sublattices_move_as_known():
    labels, start = np.array([0, 1, 2, 0, 1, 2, 1]), random_spins((7,))
    drawn = np.random.default_rng(3).normal(size=(7, 7))
    matrix = np.where(labels[:, None] != labels, drawn + drawn.T, 0)
    body = ml.spins.Spins(sublattices=labels)
    energy = ml.torques.FromPotential(lambda t, s: jnp.sum(matrix * (s.spin @ s.spin.T)) / 4)
    run = {"dt": 0.02, "steps": 20, "save_every": None}
    found = ml.integrate("SUBLATTICES[EA]", body, energy, ml.spins.SpinState(start), **run).states.spin
    true = motion_numpy(start, 0.4, 0.0, lambda t, s: -matrix @ s / 2)
    assert np.abs(found - true).max() < 2e-3


def test_a_damped_spin_opposite_to_the_field_keeps_its_length_or_fails():
    """There a length that is not one goes away from it, faster than the spin from the pole."""
    spins, dtype = np.array([[0.0, 0.0, -1.0], [1e-9, 0.0, -1.0], [0.6, 0.0, -0.8]]), np.float32
    spins = (spins / np.linalg.norm(spins, axis=1, keepdims=True)).astype(dtype)

    def ran(damping, strength, spins, steps):
        field = ml.spins.AppliedField(jnp.array([0.0, 0.0, strength], dtype))
        return run("SUBLATTICES[EA]", damping, field, spins, 1.0, steps, save_every=steps // 8 or 1)

    for kept in (ran(0.1, 1.0, spins, 800), ran(1.0, 4.0, spins, 1), ran(1.0, 16.0, spins[2:], 1)):
        assert kept.ok
        lengths = np.linalg.norm(np.asarray(kept.states.spin, float), axis=-1)
        assert np.abs(lengths - 1).max() < 200 * np.finfo(dtype).eps
    assert not ran(1.0, 16.0, spins, 1).ok  # alpha g B t = 4 in each of the two turns of the step


@pytest.mark.parametrize("damping", [0.0, 1e-9, 0.2])
def test_a_spin_under_its_own_anisotropy_is_the_closed_form(damping):
    """z/sqrt(1 - z^2) grows as exp(2 K a g t), and the angle is the change of atanh(z) over a."""
    strength, start, end = 0.7, random_spins(()), 3.0
    z = start[2]
    g = 1 / (1 + damping**2)
    after = np.sinh(np.arctanh(z)) * np.exp(2 * strength * damping * g * end)
    z1 = after / np.sqrt(1 + after**2)
    angle = (np.arctanh(z1) - np.arctanh(z)) / damping if damping > 1e-6 else 2 * strength * z * end
    turned = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) @ start[:2]
    expected = np.append(turned / np.linalg.norm(turned) * np.sqrt(1 - z1**2), z1)
    path = run("SUBLATTICES[EA]", damping, ml.spins.Anisotropy(strength), start, 1.5, 2)
    assert np.abs(path.states.spin - expected).max() < (1e-8 if damping == 1e-9 else 1e-13)
    poles = run("SUBLATTICES[EA]", damping, ml.spins.Anisotropy(strength), np.array([0.0, 0.0, -1.0]), 1.5, 2)
    assert np.allclose(poles.states.spin, [0.0, 0.0, -1.0], rtol=0, atol=1e-15)


@pytest.mark.parametrize(("name", "shape", "closes"), [("BAOAB", (4, 2, 4), False), ("BM4", (6,), True)])
def test_a_checkerboard_in_two_rows_is_the_same_as_with_masks(shape, closes, name):
    """Given by its labels, the lattice is moved with masks; also in a heat bath, whose numbers belong to places."""
    vectors = jnp.asarray(np.random.default_rng(4).normal(size=(len(shape), 3)))
    torque = ml.spins.Exchange(jnp.linspace(0.5, 1.0, len(shape)), closes) + ml.spins.AppliedField(shaken)
    torque = torque + ml.spins.DzyaloshinskiiMoriya(vectors, closes) + ml.spins.Anisotropy(0.3, EASY)
    start = ml.spins.SpinState(jnp.asarray(random_spins(shape)))
    bath = ml.spins.ThermalField(0.4, jax.random.key(7)) if name == "BAOAB" else None
    run = {"dt": 0.1, "steps": 8, "save_every": 4, "bath": bath}
    bodies = (ml.spins.Spins(0.1, sublattices=labels) for labels in (None, ml.spins.checkerboard(shape)))
    rows, masked = (ml.integrate(f"SUBLATTICES[{name}]", body, torque, start, **run) for body in bodies)
    assert rows.ok
    assert np.abs(rows.states.spin[-1] - start.spin).max() > 0.1
    assert np.allclose(rows.states.spin, masked.states.spin, rtol=0, atol=1e-13)


FIVE = np.arange(1.0, 6.0)


@pytest.mark.parametrize(
    ("lattice", "torque", "last"),
    [
        ((4, 4), *[ml.spins.DzyaloshinskiiMoriya(VECTORS)] * 2),
        ((4, 4), ml.spins.Exchange(np.outer(FIVE, EXCHANGE)), ml.spins.Exchange(5 * EXCHANGE)),
        ((), ml.spins.Anisotropy(FIVE), ml.spins.Anisotropy(5.0)),
    ],
    ids=["vectors", "rows of couplings", "single spins"],
)
def test_in_an_ensemble_a_field_has_the_axes_of_one_lattice(lattice, torque, last):
    spin, few = jnp.asarray(random_spins((5, *lattice))), {"dt": 0.1, "steps": 2, "save_every": 2}
    found = ml.ensemble("SUBLATTICES[EA]", ml.spins.Spins(), torque, ml.spins.SpinState(spin), **few)
    alone = ml.integrate("SUBLATTICES[EA]", ml.spins.Spins(), last, ml.spins.SpinState(spin[-1]), **few)
    assert np.abs(found.states.spin[-1] - alone.states.spin).max() < 1e-14


def test_coupled_spins_in_a_heat_bath_and_free_ones():
    """Of a pair <S1 . S2> = coth x - 1/x with x = J/kT; without a field <S(t) . S(0)> = exp(-2 D t)."""
    x, count = 2.0, 1500
    exchange = ml.spins.Exchange(jnp.asarray([0.0, 1.0]), periodic=False)
    run = {"dt": 0.2, "steps": 400, "save_every": 40, "bath": ml.spins.ThermalField(1 / x, jax.random.key(2))}
    start = ml.spins.SpinState(jnp.asarray(random_spins((count, 2))))
    path = ml.integrate("SUBLATTICES[OBABO]", ml.spins.Spins(0.4), exchange, start, **run)
    seen = np.sum(path.states.spin[5:, :, 0] * path.states.spin[5:, :, 1], axis=-1)
    assert abs(seen.mean() - (1 / np.tanh(x) - 1 / x)) < 5 * seen.std() / np.sqrt(count)
    bath = ml.spins.ThermalField(0.9, jax.random.key(3))
    free = ml.integrate("SUBLATTICES[BAOAB]", ml.spins.Spins(0.3), None, start, dt=0.5, steps=4, bath=bath)
    spread = 0.9 * 0.3 / (1 + 0.3**2)
    along = np.sum(np.asarray(free.states.spin) * np.asarray(start.spin), axis=-1).reshape(5, -1)
    assert np.abs(along.mean(axis=1) - np.exp(-2 * spread * 0.5 * np.arange(5))).max() < 5 / np.sqrt(3 * 2 * count)


NEAR = ml.spins.Exchange(1.0)
HEAT, LANGEVIN = ml.spins.ThermalField(1.0, jax.random.key(0)), ml.baths.Langevin(1.0, 1.0, jax.random.key(0))
CHAIN, ODD = (ml.spins.SpinState(jnp.asarray(random_spins((n,)))) for n in (6, 5))
UP, DAMPED, HEATED = ml.spins.AppliedField([0.0, 0.0, 1.0]), ml.spins.Spins(0.1), "SUBLATTICES[BAOAB]"
TERM, SOLVER = ml.diffrax.RigidBodyTerm(ml.spins.Spins(), NEAR), ml.diffrax.LieSolver("SUBLATTICES[EA]")
VARIABLE = {"density": lambda t, state: jnp.ones(()), "dt": 0.1, "steps": 2}


def go(torque, start, body=None, name="SUBLATTICES[EA]", drive=ml.integrate, **options):
    return drive(name, body or ml.spins.Spins(), torque, start, **{"dt": 0.1, "steps": 2, **options})


def of_many(torque, shape, body=None):
    return go(torque, ml.spins.SpinState(jnp.asarray(random_spins(shape))), body, drive=ml.ensemble)


test_what_is_refused = refused(
    (lambda: ml.method("SUBLATTICES"), "add a scheme"),
    (lambda: ml.spins.SpinState([[1.0, 1.0, 0.0]]), "spin must be unit vectors.*divide it by its norm"),
    (lambda: ml.spins.Spins(sublattices=[0, 2]), "sublattices must use every number"),
    (lambda: go(NEAR, ODD), "is periodic with an odd number of 5 sites.*sublattices.*spherical midpoint"),
    (lambda: go(NEAR, ml.spins.SpinState([0.0, 0.0, 1.0])), "needs a lattice"),
    (lambda: go(NEAR, CHAIN, ml.spins.Spins(sublattices=[0, 1])), r"shape \(6,\) of the lattice"),
    (lambda: go(ml.torques.FromPotential(lambda t, s: jnp.sum(s.spin[:, 2] ** 2)), CHAIN), "spins of sublattice 0"),
    (lambda: go(Before(), CHAIN), r"depends on spins of sublattice 0.*Spins\(sublattices"),
    (lambda: go(ml.spins.CubicAnisotropy(1.0), CHAIN, DAMPED), "no closed form.*spherical midpoint"),
    (lambda: go(ml.torques.HeavyTop(1.0), CHAIN), "no body frame.*give a field.*AppliedField"),
    (lambda: go(UP + ml.torques.Damping(5.0), CHAIN), r"Damping reads the angular velocity.*Spins\(damping=...\)"),
    (lambda: go(NEAR, CHAIN, name="SUBLATTICES[CHIN4A]"), "uses gradients of forces"),
    (lambda: go(NEAR, CHAIN, bath=HEAT), "must have a stage for the bath"),
    (lambda: go(NEAR, CHAIN, name=HEATED), r"bath=midlie_jax.spins.ThermalField\(kT, key\)"),
    (lambda: go(NEAR, CHAIN, name=HEATED, bath=LANGEVIN), "Langevin acts on rigid bodies and rotors, not"),
    (lambda: go(None, CHAIN, name=HEATED, bath=HEAT), "needs a damping"),
    (lambda: go(ml.spins.Anisotropy(np.ones(3)), CHAIN), r"strength must be \(\).* or \(6,\).*got \(3,\)"),
    (lambda: go(NEAR, CHAIN, ml.spins.Spins(np.ones(3))), r"damping must be \(\).* or \(6,\).*got \(3,\)"),
    (lambda: go(ml.spins.AppliedField(np.ones((5, 3))), CHAIN), r"value must be \(3,\).* or \(6, 3\).*\(5, 3\)"),
    (lambda: go(ml.spins.Exchange(jnp.ones(2)), CHAIN), r"coupling must be \(\) or \(1,\)"),
    (lambda: of_many(NEAR, (6, 4), ml.spins.Spins(np.ones(6))), r"damping must be \(\).* or \(4,\)"),
    (lambda: of_many(ml.spins.Exchange(1.0, (True,)), (6, 4, 2)), "periodic has 1 entries.*2 axes"),
    (lambda: of_many(ml.spins.DzyaloshinskiiMoriya(VECTORS), (6, 4)), r"vectors must be \(1, 3\)"),
    (lambda: of_many(UP, ()), r"start.spin must be \(n, ..., 3\)"),
    (lambda: ml.observe.energy(ml.spins.Spins(), ml.spins.Exchange([1.0, 2, 3]), CHAIN), r"coupling must be \(\)"),
    (lambda: SOLVER.init(TERM, 0.0, 1.0, CHAIN, None), "diffrax does not support spins; use midlie_jax.integrate"),
    (lambda: go(NEAR, CHAIN, drive=ml.integrate_variable_step, **VARIABLE), "spins run with a constant step"),
)


def test_a_step_that_is_too_long_shows_in_ok():
    """A turn beyond the longest, and D h = 2 in a bath: the law of its stage holds up to 1."""
    assert not go(ml.spins.AppliedField([0.0, 0.0, 100.0]), CHAIN).ok
    hot = ml.spins.ThermalField(40.0, HEAT.key)
    assert not go(UP, CHAIN, ml.spins.Spins(1.0), HEATED, bath=hot).ok


class Before(ml.spins.SpinField):
    """A field of the user's own from the place before, which has the same parameters for all spins."""

    def field(self, t, spin):
        return tuple(jnp.roll(x, 1, -1) for x in spin)

    def energy(self, t, spin):
        return 0 * spin[0]


@pytest.mark.parametrize(("name", "near"), [("SUBLATTICES[EA]", False), ("spherical midpoint", True)])
def test_python_numbers_run_in_float32(name, near):
    own = ml.spins.CubicAnisotropy(0.2) + ml.spins.Anisotropy(0.3) + ml.spins.Anisotropy(0.3, [0, 0.6, 0.8])
    start = ml.spins.SpinState(jnp.asarray(random_spins((6,), dtype="float32")))
    path = go(own + NEAR if near else own, start, name=name)
    assert path.ok
    assert path.states.spin.dtype == jnp.float32
