"""docs/coming-from/molecular-dynamics.md: a cluster of rigid molecules in jax-md, in LAMMPS and here."""

from collections.abc import Iterator

from . import columns, tables
from .alone import parts, run
from .compare import Row, agree, changed, errors, row

TITLE = "jax-md or LAMMPS"
HEADS = ("jax-md", "LAMMPS")  # the left columns
NEEDS = ("jax_md", "lammps")
QUANTITIES = ("times", "sites")
WITHIN = 1e-3  # the error of order 2 at this step, relative to the largest coordinate; all of them share it

_NAME = "molecular-dynamics"
_OWN = """
one, two = jnp.triu_indices(N, 1)
def force(body, **_):
    s = rigid_body.union_to_points(body, shape)[0].reshape(N, 3, 3)
    d = s[one][:, :, None] - s[two][:, None]
    sixth = jnp.sum(d * d, axis=-1) ** -3
    return 4 * jnp.sum(sixth * sixth - sixth)
"""
_PAIRS = "force = rigid_body.point_energy(pairs, shape)\n"
_REPLICAS = "shifts = 0.05 * jax.random.normal(jax.random.key(1), (100, N, 3))\n"
_THEIR_REPLICAS = f"""
{_REPLICAS}
def begun(shift):
    moved = rigid_body.RigidBody(corners + shift, bodies.orientation)
    return init(jax.random.key(0), moved, 0.0, mass=shape.mass())

states, many = jax.vmap(begun)(shifts), jax.jit(jax.vmap(run))

sites = many(states)
"""
_OUR_REPLICAS = f"""
{_REPLICAS}
starts = jax.vmap(lambda shift: ml.CoupledState(rest, q, rest, corners + shift))(shifts)

path = ml.ensemble("JACOBI[EA]", body, force, starts, dt=2.0**-9, steps=1024, save_every=32)
sites = jax.jit(ml.molecules.sites)(path.states, places)
"""


def programs() -> list[tuple[str, str]]:
    """The left and the right program of each table; the right one of LAMMPS goes on from that of jax-md."""
    left, right = columns(_NAME)
    lammps, later = tables(_NAME)[1]
    return [(left, right), (lammps, parts(right)[0] + later)]


def rows() -> Iterator[Row]:
    pairs = programs()
    exact = run(changed(pairs[0][1], ("JACOBI[EA]", "GBS12")), QUANTITIES)
    for program, (left, right) in zip(HEADS, pairs, strict=True):
        theirs, ours = run(left, QUANTITIES), run(right, QUANTITIES, 7)
        agree(_NAME, theirs, ours)
        # Repeated runs of LAMMPS go on from where it is; so they are timed apart.
        yield row(f"the run above: {program}", run(left, QUANTITIES, 7).later, ours.later)
        yield row(f"its first call, with compiling: {program}", theirs.first, ours.first)
        yield errors(f"its error: {program}", (theirs, ours), exact, "sites")
        if program == "jax-md":
            with_ours = changed(left, (_PAIRS, _OWN))
            own = run(with_ours, QUANTITIES, 7)
            agree(_NAME, own, ours)
            yield row("the run above: jax-md, with the pair energy of the right", own.later, ours.later)
            theirs, ours = (
                run(parts(code)[0] + more, ("sites",), 2)
                for code, more in ((with_ours, _THEIR_REPLICAS), (right, _OUR_REPLICAS))
            )
            agree(_NAME, theirs, ours)
            yield row("100 clusters at once: jax-md, with that energy", theirs.later, ours.later)
        left, right = (changed(code, ("n, N = 2, 8", "n, N = 4, 64")) for code in (left, right))
        theirs, ours = (run(code, QUANTITIES, 1).later for code in (left, right))
        yield row(f"64 molecules: {program}", theirs, ours)
