"""Deformable solids by the methods for particles: docs/reports/applications.md, and the pictures of docs/solids.md.

    python benchmarks/solids.py block [--write]    a thrown block of gel: momenta, energy bands; thrown-block.png, .gif
    python benchmarks/solids.py bar [--write]      a fixed bar beside d'Alembert's solution
    python benchmarks/solids.py cost [--write]     a step beside the one force that it evaluates

Times are processor times on one core; programs that are compared take turns. The meshes are made by scikit-fem, which
`pip install 'midlie_jax[solids]'` brings.
"""

from collections.abc import Callable, Iterator
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import one_core  # noqa: F401
from harness import DOCS, Table, in_turn, main
from jax import Array
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb
from PIL import Image

import midlie_jax as ml
from midlie_jax.cli.figures import write
from midlie_jax.plot.style import BLUE, GREY, new_figure

PAGE = "reports/applications.md"

# ---- a neo-Hookean solid of linear tetrahedra ----


def triple_product(F: Array) -> Array:
    return jnp.sum(F[:, 0] * jnp.cross(F[:, 1], F[:, 2]), axis=1)


class NeoHookean(eqx.Module):
    """The elastic energy of tetrahedra, W = V [mu/2 (tr F^T F - 3) - mu ln J + lambda/2 ln^2 J] of each.

    F = Ds Dm^-1 is the deformation gradient, constant in a tetrahedron, and J its determinant (Bonet and Wood,
    Nonlinear Continuum Mechanics for Finite Element Analysis, section 6.4.3). The energy is NaN where a tetrahedron is
    turned inside out, so such a run fails with `ok` False. The derivative of `jnp.linalg.det` factorises every matrix,
    and so is slow.
    """

    corners: Array  # the nodes of each tetrahedron, (e, 4)
    inverse: Array  # of its three edges at rest, (e, 3, 3)
    volume: Array  # at rest, (e,)
    mu: Array
    lame: Array
    determinant: Callable[[Array], Array] = eqx.field(static=True)

    def __init__(
        self, nodes: Array, corners: Any, mu: Any, lame: Any, determinant: Callable[[Array], Array] = triple_product
    ):
        self.determinant = determinant
        self.corners = jnp.asarray(corners)
        edges = self.edges(nodes)
        self.inverse, self.volume = jnp.linalg.inv(edges), jnp.abs(jnp.linalg.det(edges)) / 6
        self.mu, self.lame = (jnp.asarray(x, nodes.dtype) for x in (mu, lame))

    def edges(self, nodes: Array) -> Array:
        places = nodes[self.corners]
        return jnp.swapaxes(places[:, 1:] - places[:, :1], 1, 2)

    def __call__(self, t: Any, state: ml.ParticleState) -> Array:
        del t
        F = self.edges(state.position) @ self.inverse
        log_J = jnp.log(self.determinant(F))
        density = self.mu / 2 * (jnp.sum(F**2, axis=(1, 2)) - 3) - self.mu * log_J + self.lame / 2 * log_J**2
        return jnp.sum(self.volume * density)

    def masses(self, nodes: Array, density: float) -> Array:
        quarter = density * self.volume[:, None] / 4
        shared = jnp.broadcast_to(quarter, self.corners.shape)
        return jnp.zeros(len(nodes), nodes.dtype).at[self.corners].add(shared)[:, None]


def longest_step(energy: Any, mass: Array, nodes: Array, rounds: int = 400) -> float:
    """2/omega_max, beyond which Verlet is unstable: of the stiffest small vibration about these nodes.

    omega_max^2 is the largest eigenvalue of M^-1/2 K M^-1/2. Power iteration finds it from below: what is returned is
    longer than the true limit, by some per mille at most. K is applied as the derivative of the force.
    """
    root = jnp.sqrt(mass)

    def force(x: Array) -> Array:
        return -jax.grad(lambda y: energy(0.0, ml.ParticleState(jnp.zeros_like(y), y)))(x)

    def stiffness(v: Array) -> Array:
        return -jax.jvp(force, (nodes,), (v / root,))[1] / root

    def turn(_: Any, v: Array) -> Array:
        v = stiffness(v)
        return v / jnp.linalg.norm(v)

    first = jax.random.normal(jax.random.key(0), nodes.shape, nodes.dtype)
    stiffest = jax.jit(lambda v: jax.lax.fori_loop(0, rounds, turn, v))(first)
    return float(2 / jnp.sqrt(jnp.linalg.norm(stiffness(stiffest))))


def angular_momentum(state: ml.ParticleState) -> Array:
    return jnp.sum(jnp.cross(state.position, state.momentum), axis=-2)


# ---- the thrown block ----

SIZES, CELLS = (0.2, 0.1, 0.05), (4, 2, 1)  # m, and cells along each edge in the tables; each cell has six tetrahedra
MU, LAME, DENSITY = 8e3, 3e4, 1000.0  # Pa, Pa, kg/m^3
VELOCITY, SPIN = (2.0, 0.0, 2.5), (3.0, 25.0, 6.0)  # m/s, rad/s
TIME = 0.2  # s
METHODS = ("symplectic Euler", "adjoint symplectic Euler", "Verlet", "position Verlet", "implicit midpoint", "RK4")
HALVINGS = 3

_SHARES, _LIMIT_STEPS, _SMALL = (0.99, 1.01), 60, 1e-9  # m, of the nodes at the start
LIMIT_CELLS = ((4, 2, 1), (8, 4, 2), (16, 8, 4))


class Block(NamedTuple):
    """A block at its start: undeformed, with the velocities of a rigid body."""

    body: ml.Particles
    energy: NeoHookean
    start: ml.ParticleState
    nodes: Any
    corners: Any


def block(cells: tuple[int, int, int], dtype: Any = "float64") -> Block:
    from skfem import MeshTet

    axes = [np.linspace(-size / 2, size / 2, count + 1) for size, count in zip(SIZES, cells, strict=True)]
    mesh = MeshTet.init_tensor(*axes)
    nodes = jnp.asarray(mesh.p.T, dtype)
    energy = NeoHookean(nodes, mesh.t.T, MU, LAME)
    mass = energy.masses(nodes, DENSITY)
    velocity = jnp.asarray(VELOCITY, dtype) + jnp.cross(jnp.asarray(SPIN, dtype), nodes)
    return Block(ml.Particles(mass), energy, ml.ParticleState(mass * velocity, nodes), nodes, mesh.t.T)


class Kept(NamedTuple):
    """What a run keeps, of each saved state: the energy (k,), J, and the momenta (k, 3), kg m/s and kg m^2/s."""

    energy: Any
    linear: Any
    angular: Any


@cache
def limit(cells: tuple[int, int, int] = CELLS) -> float:
    made = block(cells)
    return longest_step(made.energy, made.body.mass, made.nodes)


def observed(method: str, step: float, times: int = 1) -> Kept:
    """Energy and momenta of every state of a free flight of so many times `TIME`."""
    made = block(CELLS)
    force = ml.torques.FromPotential(made.energy)

    def seen(t: Any, state: ml.ParticleState) -> Kept:
        energy = ml.observe.kinetic_energy(made.body, state) + made.energy(t, state)
        return Kept(energy, jnp.sum(state.momentum, axis=0), angular_momentum(state))

    steps = times * round(TIME / step)
    path = ml.integrate(method, made.body, force, made.start, dt=step, steps=steps, observe=seen)
    if not bool(path.ok):
        raise RuntimeError(f"{method} failed; take a shorter step.")
    return jax.tree.map(np.asarray, path.states)


def drift(values: np.ndarray) -> float:
    """The largest change of a vector in a run, relative to its length at the start."""
    return float(np.linalg.norm(values - values[0], axis=1).max() / np.linalg.norm(values[0]))


def band(energies: np.ndarray) -> float:
    """The largest change of the energy, relative to the energy at the start."""
    return float(np.abs(energies - energies[0]).max() / energies[0])


def first_step() -> float:
    return TIME / round(3 * TIME / limit())


def block_rows() -> Iterator[list[str]]:
    for method in METHODS:
        runs = [observed(method, first_step() / 2**k) for k in range(HALVINGS)]
        bands = [band(run.energy) for run in runs]
        ratios = [f"{a / b:.2f}" for a, b in pairwise(bands)]
        kept = [f"{drift(getattr(runs[0], name)):.0e}" for name in ("linear", "angular")]
        longer = band(observed(method, first_step(), 10).energy)
        yield [f"`{method}`", *kept, *(f"{value:.1e}" for value in bands), *ratios, f"{longer:.1e}"]


def growth(cells: tuple[int, int, int], share: float) -> float:
    """How many times a small random displacement grows in 60 steps of this share of the limit."""
    made = block(cells)
    displaced = _SMALL * jax.random.normal(jax.random.key(1), made.nodes.shape)
    start = ml.ParticleState(jnp.zeros_like(made.nodes), made.nodes + displaced)
    force, dt = ml.torques.FromPotential(made.energy), share * limit(cells)
    end = ml.integrate("Verlet", made.body, force, start, dt=dt, steps=_LIMIT_STEPS).states.position
    return float(jnp.max(jnp.abs(end - made.nodes)) / jnp.max(jnp.abs(displaced)))


def limit_rows() -> Iterator[list[str]]:
    for cells in LIMIT_CELLS:
        made = block(cells)
        sizes = str(len(made.corners)), str(len(made.nodes)), f"{1e3 * limit(cells):.3g}"
        yield [*sizes, *(f"{growth(cells, share):.2g}" for share in _SHARES)]


# ---- its pictures, with gravity: five frames, and a GIF in slow motion ----

DRAWN = (8, 4, 2)
GRAVITY, FLIGHT = 9.81, 0.5  # m/s^2, s
FRAMES, STILLS, RATE = 49, 5, 12  # frames of the GIF, of the picture, and frames a second
_LIGHT = np.array([-0.4, -0.6, 0.7]) / np.linalg.norm([-0.4, -0.6, 0.7])
_WIDTH, _HEIGHT, _DPI = 5.6, 3.0, 80
_SHADES = 12
_GIF_COLOURS = 32


class Flight(NamedTuple):
    """Times (k,), places of nodes (k, n, 3) and centre of mass (k, 3), and the triangles of the surface (f, 3)."""

    times: np.ndarray
    places: np.ndarray
    middle: np.ndarray
    triangles: np.ndarray


def surface(corners: np.ndarray) -> np.ndarray:
    """The triangles (f, 3) that belong to one tetrahedron only."""
    faces = np.concatenate([np.delete(corners, k, axis=1) for k in range(4)])
    faces, counts = np.unique(np.sort(faces, axis=1), axis=0, return_counts=True)
    return faces[counts == 1]


def flight() -> Flight:
    made: Block = block(DRAWN)
    mass, intervals = made.body.mass, FRAMES - 1

    def weight(t: Any, state: ml.ParticleState) -> Any:
        del t
        return GRAVITY * jnp.sum(mass[:, 0] * state.position[:, 2])

    forces = ml.torques.FromPotential(made.energy) + ml.torques.FromPotential(weight)
    every = int(np.ceil(FLIGHT / intervals / (limit(DRAWN) / 3)))
    run: Any = {"dt": FLIGHT / (intervals * every), "steps": intervals * every, "save_every": every}
    path = ml.integrate("Verlet", made.body, forces, made.start, **run)
    places = np.asarray(path.states.position)
    middle = np.einsum("n,knc->kc", np.asarray(mass[:, 0] / jnp.sum(mass)), places)
    return Flight(np.asarray(path.times), places, middle, surface(np.asarray(made.corners)))


def _block(axes: Any, places: np.ndarray, triangles: np.ndarray) -> Any:
    """Adds the surface, seen along y: the far triangles first, each as light as it faces the light."""
    spanned = places[triangles]
    order = np.argsort(-spanned[:, :, 1].mean(axis=1))
    normals = np.cross(spanned[:, 1] - spanned[:, 0], spanned[:, 2] - spanned[:, 0])
    outward = np.sign(normals[:, 1:2]) * -normals  # towards the viewer, at negative y
    share = np.clip(outward @ _LIGHT / np.linalg.norm(normals, axis=1), 0, 1)
    share = np.round(share * _SHADES) / _SHADES
    shade = share[:, None]  # from a darker to a lighter blue
    faces = np.clip(np.array(to_rgb(BLUE)) * (0.35 + 0.6 * shade) + 0.3 * shade, 0, 1)
    style: Any = {"edgecolors": "white", "linewidths": 0.25}
    return axes.add_collection(PolyCollection(list(spanned[order][:, :, [0, 2]]), facecolors=faces[order], **style))


def _panel(found: Flight, width: float = _WIDTH, height: float = _HEIGHT, dpi: int = _DPI) -> tuple[Any, Any]:
    """A figure with equal scales of both axes, and the path of the centre of mass."""
    figure = new_figure(width, height)
    figure.set_dpi(dpi)
    axes = figure.add_axes((0.11, 0.17, 0.87, 0.8))
    axes.set_aspect("equal")
    axes.set_xlim(-0.15, 1.15)
    axes.set_ylim(-0.14, 0.47)
    axes.set_xlabel("x [m]")
    axes.set_ylabel("height z [m]")
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=9)
    axes.plot(found.middle[:, 0], found.middle[:, 2], ":", color=GREY, linewidth=1)
    return figure, axes


def still(found: Flight, out: Path) -> None:
    figure, axes = _panel(found, 8.0, 4.2, 110)
    axes.set_position((0.11, 0.15, 0.87, 0.76))
    axes.set_title("The block bends; its centre of mass moves on a parabola", loc="left", fontsize=11, weight="bold")
    for k in np.linspace(0, FRAMES - 1, STILLS).round().astype(int):
        _block(axes, found.places[k], found.triangles)
        x, top = found.middle[k, 0], found.places[k, :, 2].max()
        axes.annotate(
            f"t = {found.times[k]:.3g} s", (x, top), xytext=(0, 5), textcoords="offset points", ha="center", fontsize=9
        )
    axes.annotate(
        "centre of mass", found.middle[FRAMES // 10, [0, 2]], xytext=(-8, 0), textcoords="offset points",
        color=GREY, fontsize=9, ha="right",
    )  # fmt: skip
    write(figure, str(out))


def movie(found: Flight, out: Path) -> None:
    figure, axes = _panel(found)
    clock = axes.text(0.98, 0.94, "", transform=axes.transAxes, ha="right", fontsize=9)
    pictures = []
    for time, places in zip(found.times, found.places, strict=True):
        drawn = _block(axes, places, found.triangles)
        clock.set_text(f"t = {time:.2f} s, 1/{(FRAMES - 1) / (FLIGHT * RATE):.2g} of real speed")
        figure.canvas.draw()
        pictures.append(Image.fromarray(np.asarray(figure.canvas.buffer_rgba())[..., :3].copy()))
        drawn.remove()
    some = pictures[:: len(pictures) // 6]
    sheet = Image.fromarray(np.concatenate([np.asarray(picture) for picture in some]))
    palette = sheet.quantize(_GIF_COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    few = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    few[0].save(out, save_all=True, append_images=few[1:], duration=round(1000 / RATE), loop=0, optimize=True)


def draw(folder: Path) -> None:
    found = jax.block_until_ready(flight())
    still(found, folder / "thrown-block.png")
    movie(found, folder / "thrown-block.gif")


BLOCK = Table(
    *(PAGE, "solids block"),
    (
        *("method", "linear momentum", "angular momentum", "energy, h", "h/2", "h/4", "ratio", "ratio"),
        "h, 10 times as long",
    ),
    *(block_rows, "solids-block"),
    columns=(0, 2, 3, 6, 8),
)
LIMITS = Table(
    *(PAGE, "solids limits"),
    ("tetrahedra", "nodes", "2/omega_max, ms", *(f"growth at {share} of it" for share in _SHARES)),
    limit_rows,
)


def thrown(options: Any) -> None:
    BLOCK.show(options.write)
    LIMITS.show(options.write)
    if options.write:
        draw(DOCS)


# ---- the bar of length 1 and wave speed c = 1: N elements of length dx = 1/N, and mass dx at each node within ----
#
# In mode n its nodes move as sin(n pi i/N) cos(omega t) with sin(omega h/2) = (c h/dx) sin(n pi/(2 N)). At c h = dx
# this omega is that of the bar itself, n pi c: the nodes move as d'Alembert's waves do.

ELEMENTS, MODE = 50, 3
CASES = ((1.0, 10_000), (0.4, 10_000))  # c h/dx, and steps


class Run(NamedTuple):
    """A run: times (k,), the motion of the nodes and its closed form (k, N - 1), and the frequency of this form."""

    times: np.ndarray
    found: np.ndarray
    exact: np.ndarray
    frequency: float


def elastic(t: Any, state: ml.ParticleState) -> Any:
    del t
    u = jnp.pad(state.position, 1)
    return ELEMENTS / 2 * jnp.sum(jnp.diff(u) ** 2)


def case(courant: float, steps: int) -> Run:
    shape = np.sin(MODE * np.pi * np.arange(1, ELEMENTS) / ELEMENTS)
    start = ml.ParticleState(jnp.zeros(ELEMENTS - 1), jnp.asarray(shape))
    h = courant / ELEMENTS
    body, force = ml.Particles(jnp.asarray(1 / ELEMENTS)), ml.torques.FromPotential(elastic)
    path = ml.integrate("Verlet", body, force, start, dt=h, steps=steps)
    # Extended precision: in float64 the phase of the closed form itself has an error above that of the run.
    half = np.arcsin(np.longdouble(str(courant)) * np.sin(MODE * PI / (2 * ELEMENTS)))
    exact = np.cos(2 * half * np.arange(steps + 1, dtype=np.longdouble))[:, None] * shape
    return Run(np.asarray(path.times), np.asarray(path.states.position), exact, float(2 * half / h))


PI = np.longdouble("3.14159265358979323846264338327950288")


def bar_rows() -> Iterator[list[str]]:
    for courant, steps in CASES:
        run = case(courant, steps)
        error = float(np.abs(run.found - run.exact).max())
        frequencies = f"{run.frequency:.9f}", f"{MODE * np.pi:.9f}"
        yield [f"{courant:g}", str(steps), f"{run.times[-1]:g}", *frequencies, f"{error:.1e}"]


BAR_HEADS = "c h/dx", "steps", "time", "frequency", "of the bar", "largest error of a node"
BAR = Table(PAGE, "solids bar", BAR_HEADS, bar_rows)


# ---- what a step takes beside the one force that it evaluates, and beside Verlet by hand ----

MESHES = ((8, 4, 2), (16, 8, 4))  # cells
TIMED = ("Verlet", "position Verlet", "symplectic Euler")
_STEPS, _ROUNDS = 400, 9


def programs(made: Block, dt: Any) -> dict[str, Callable[[], Any]]:
    mass, start, energy = made.body.mass, made.start, made.energy
    force = ml.torques.FromPotential(energy)
    slow = NeoHookean(made.nodes, made.corners, MU, LAME, jnp.linalg.det)

    def gradient(x: Any, energy: Any = energy) -> Any:
        return jax.grad(lambda y: energy(0.0, ml.ParticleState(jnp.zeros_like(y), y)))(x)

    def forces(energy: Any) -> Callable[[], Any]:
        """Each force needs the one before, so that none is left out."""

        def next_one(_: Any, x: Any) -> Any:
            return x - dt * dt / mass * gradient(x, energy)

        program = jax.jit(lambda x: jax.lax.fori_loop(0, _STEPS, next_one, x))
        return lambda: program(start.position)

    def by_hand(_: Any, pxf: Any) -> Any:
        p, x, f = pxf
        half = p + dt / 2 * f
        x = x + dt * half / mass
        f = -gradient(x)
        return half + dt / 2 * f, x, f

    hand = jax.jit(lambda p, x: jax.lax.fori_loop(0, _STEPS, by_hand, (p, x, -gradient(x))))

    def run(method: str) -> Callable[[], Any]:
        return lambda: ml.integrate(method, made.body, force, start, dt=dt, steps=_STEPS, save_every=_STEPS)

    return {
        "force alone, `jax.grad`": forces(energy),
        "the same with `jnp.linalg.det`": forces(slow),
        "Verlet by hand in `jax.lax.fori_loop`": lambda: hand(start.momentum, start.position),
    } | {f"`{method}`": run(method) for method in TIMED}


def cost_rows() -> Iterator[list[str]]:
    for cells in MESHES:
        made = {dtype: block(cells, dtype) for dtype in ("float64", "float32")}
        named = {
            (dtype, name): run
            for dtype, own in made.items()
            for name, run in programs(own, jnp.asarray(limit(cells) / 3, dtype)).items()
        }
        seconds = {key: time / _STEPS for key, time in zip(named, in_turn(named.values(), _ROUNDS), strict=True)}
        for (dtype, name), own in seconds.items():
            size = str(len(made[dtype].corners)), str(made[dtype].nodes.size), dtype
            least = next(value for (other, _), value in seconds.items() if other == dtype)
            yield [*size, name, f"{1e6 * own:.0f}", f"{own / least:.2f}", f"{1 / own:.0f}"]


COST = Table(
    *(PAGE, "solids cost"),
    ("tetrahedra", "coordinates", "dtype", "", "µs per step", "relative to the force", "steps/s"),
    *(cost_rows, "solids-cost", lambda row: row[0] == "3072" and row[2] == "float64", (3, 4, 5)),
)

if __name__ == "__main__":
    main(__doc__, {"block": thrown, "bar": BAR, "cost": COST})
