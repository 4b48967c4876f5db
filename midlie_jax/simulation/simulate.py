"""`simulate`: the driver for long runs of many bodies, which computes a run in parts and writes each to a file."""

import time
from collections.abc import Callable
from contextlib import ExitStack
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.sharding import Mesh

from .._checks.arguments import as_count, described, require_numbers
from ..drivers.arguments import as_first_step, as_saving
from ..drivers.chunks import chunk_size, even_size
from ..drivers.ensemble import Batch, as_batch, check_spread, check_times_of_batch
from ..drivers.observe import Observe, Statistic, as_observe
from ..drivers.observe.series import Series
from ..drivers.stepper import Carry, carried_on
from ..integrators.base import Method
from ..model.baths.base import HeatBath
from ..model.bodies import Body
from ..model.state import StateT
from ..model.torques import TorqueLike
from ..model.torques.reads_body import with_bath
from . import variables
from .identity import UNSEEN, differences, identity
from .parts import Computation, Progress
from .pipeline import all_succeed, compute_and_write, reported
from .plan import Plan
from .store import Memory, Store, create, remedy
from .summary import Simulation
from .variables import Arrays, Variables

_BYTES = 2**25  # about the size of one part in the file
# The most body-steps of one part, unless two saved states need more. Most runs then write a part several times per
# minute, so that a reader of the file sees progress. The work lost by a kill does not depend on it, see `pipeline.py`.
_BODY_STEPS = 3 * 10**7
_GROUP = 2**15  # bodies of one group, by default
_CARRIED = 2**28  # the most bytes that a group carries between spans for a statistic over times, by default


def simulate(
    method: Method | str,
    body: Body,
    torque: TorqueLike | None,
    start: StateT | Carry,
    *,
    out: str | Path,
    dt: float | Array,
    steps: int,
    save_every: int | None = None,
    t0: float | Array = 0.0,
    first_step: int | Array = 0,
    torque_axes: Any = "auto",
    observe: Any = None,
    resume: bool = False,
    mesh: Mesh | None = None,
    group: int | None = None,
    span: int | None = None,
    chunk: int | None = None,
    progress: bool | Callable[[int], Any] | None = None,
    attributes: dict[str, Any] | None = None,
    bath: HeatBath | None = None,
) -> Simulation[StateT]:
    """Integrates n bodies like `ensemble`, in parts that fit memory, and writes the path to a file during the run.

    A run that is stopped at any moment, by ctrl-C, a full disk or a lost machine, can be resumed. It then ends with the
    same bits as an uninterrupted run. At most about half a minute of work is lost, unless a single step of a group
    takes longer. A body that fails does not affect the others.

    Each chunk of a store ends with a checksum: reading a damaged chunk raises an error, also in Zarr and xarray.

    With `jax.distributed` every process calls `simulate` with the same arguments. Each process computes and writes a
    share of the groups, on its own devices; `out` must be a folder that all processes can access.

    Args:
        method, body, torque, start, dt, steps, t0, first_step, torque_axes, observe, bath: as for `ensemble`; `start`
            has a leading axis (n,). To continue another run with the same bits, pass its carry (`Simulation.carry`).
            To continue up to rounding, pass its last states (`Simulation.states`), with its number of steps as
            `first_step`.
        out: a folder whose name ends in .zarr, for a Zarr store (needs the extra `io`); or a file whose name ends in
            .npz, for a small run that is held in memory, is written at its end, and cannot be resumed.
        save_every: save a state, or the observed values, every `save_every` steps, beginning with the initial state.
            `None` saves only the initial and the final state.
        resume: continue the run in `out`, if there is one.
        mesh: devices over which each group of bodies is spread; by default one device. In a run of several processes
            each uses its own devices in the mesh. The numbers do not depend on the mesh.
        group: bodies that are computed at once and written to one chunk of the file; by default up to 32768, or as many
            as need 256 MB of carry for a statistic over times.
        span: saved states of a body that are written to one chunk, at least 2; by default as many as fill 32 MB, or
            need 3e7 body-steps.
        chunk: as for `ensemble`: bodies of a group moved at once on one device.
        progress: whether to show a bar, if tqdm is installed; by default only if stderr is a terminal. Or a function
            that is called after each write with the number of body-steps written.
        attributes: additional attributes of the file: names with strings, numbers, lists of strings or of numbers, or
            arrays. Names that the file has itself are not allowed, except `title`. A resumed run keeps its first
            attributes.

    Raises:
        ValueError: as for `ensemble`, or an argument is traced; `out` exists and `resume` is False; the run in `out` is
            a different one, is damaged, or is being written by another process; the torque or `observe` of a resumed
            run calls code outside the compiled program, such as `jax.pure_callback`, in which changes cannot be
            detected; an attribute has an unsupported value or a name that is taken.
        ImportError: the extra `io` is not installed.
        OSError: a part cannot be written. Data written before are kept, and the run can be resumed.

    Examples:
        >>> momentum = jnp.stack([jnp.zeros(4), jnp.zeros(4), jnp.linspace(40.0, 50.0, 4)], axis=-1)
        >>> start = ml.RigidState(momentum, jnp.tile(ml.so3.exp(jnp.array([0.3, 0.0, 0.0])), (4, 1)))
        >>> run = ml.simulate("JACOBI[EA]", body, torque, start, out="tops.zarr", dt=0.01, steps=100, save_every=10)
        >>> run.states().attitude.shape, bool(run.ok.all())
        ((4, 11, 4), True)
    """
    began = time.perf_counter()
    torque = with_bath(torque, bath)
    require_numbers("simulate", body, torque, start, dt, t0, first_step, observe)
    steps = as_count("steps", steps)
    save_every = as_saving(save_every, steps) or steps
    state, first, given = carried_on(start, first_step)
    begin = int(as_first_step(first, steps))
    cut = {"group": group, "span": span, "chunk": chunk}
    cut = {name: as_count(name, size) for name, size in cut.items() if size is not None}
    if cut.get("span", 2) < 2:
        raise ValueError("span must be at least 2 saved states, got 1.")
    path = _checked_path(out, resume)
    batch, observe = as_batch(method, body, torque, state, dt, t0, torque_axes), as_observe(observe)
    check_times_of_batch(batch, begin, steps)
    check_spread(batch, observe, mesh)
    if isinstance(observe, Statistic):
        observe.check(1 + steps // save_every)
    seen = variables.seen_leaves(batch, observe)
    existing = all_succeed(lambda: Store(path) if path.exists() else None)
    if existing is not None:  # a resumed run is divided as before; a request for another division is rejected below
        before = existing.plan
        cut = {"group": before.group, "span": before.span, "chunk": before.chunk, **cut}
    plan = _plan(batch, observe, seen, 1 + steps // save_every, save_every, cut)._replace(begin=begin)
    of_parts = variables.seen_variables(seen, observe, plan)
    others, values = variables.whole_variables(batch, plan)
    others |= variables.merged_variables(batch, observe, seen, plan)
    said = variables.attributes_of(batch, plan)
    said |= variables.checked_attributes(attributes, {*said, *variables.named(batch.mapped[2]), *of_parts, *others})
    # The devices of this process; by default a mesh of one device, so that there is only one program.
    own = Mesh(np.array(jax.local_devices()[:1]), ("bodies",)) if mesh is None else mesh.local_mesh
    computation = Computation.of(batch, observe, plan, own, given)
    if path.suffix == ".npz":
        file = Memory(path, plan, of_parts, said)
    else:
        names, components = variables.coordinates(of_parts.values())
        file, values = _store(computation, path, existing, of_parts, others | names, said), values | components
    first_bad, computed, carry = _run(computation, file, values, seen, progress)
    return Simulation(path, batch.bodies, steps, plan.saves, first_bad, computed, time.perf_counter() - began, carry)


def _checked_path(out: Any, resume: bool) -> Path:
    if not isinstance(out, str | Path) or Path(out).suffix not in (".zarr", ".npz"):
        raise ValueError(f"out must be a path that ends in .zarr or .npz, got {described(out)}.")
    path = Path(out)
    if path.suffix == ".npz" and (resume or jax.process_count() > 1):
        raise ValueError(
            f"{path} cannot be resumed, nor shared by several processes; choose a name that ends in .zarr."
        )
    if path.suffix == ".zarr" and not (find_spec("zarr") and find_spec("filelock")):
        raise ImportError(
            "a .zarr store needs Zarr and filelock: pip install 'midlie_jax[io]', or give a name that ends in .npz."
        )
    if path.exists() and not resume:
        raise ValueError(f"{path} exists; pass resume=True to go on with its run, or choose another name.")
    if not path.parent.is_dir():
        raise ValueError(f"{path} is in a folder that does not exist; create the folder first.")
    return path


def _plan(batch: Batch, observe: Observe | None, seen: Any, saves: int, save_every: int, cut: dict[str, int]) -> Plan:
    wanted, span, chunk = (cut.get(name) for name in ("group", "span", "chunk"))
    bodies, most, size = batch.bodies, _GROUP, variables.bytes_of(seen)
    if isinstance(observe, Series):
        values = variables.value_leaves(batch, observe)
        carried = variables.bytes_of(eqx.filter_eval_shape(observe.begun, 1, values))
        size, most = variables.bytes_of(values), max(1, min(most, _CARRIED // carried))
    group = min(wanted, bodies) if wanted else even_size(bodies, -(-bodies // most))
    chunk = chunk or even_size(group, -(-group // chunk_size(min(bodies, wanted or most))))
    if not wanted:
        group = min(-(-group // chunk) * chunk, bodies)
    if isinstance(observe, Statistic) and not isinstance(observe, Series):
        size /= group
    span = span or max(2, int(min(_BYTES / max(group * size, 1), _BODY_STEPS / (group * save_every))))
    return Plan(bodies, saves, save_every, group, min(saves, span), chunk)


def _store(
    computation: Computation, path: Path, existing: Store | None, of_parts: Variables, others: Variables, said: Any
) -> Store:
    """The store of this run: the existing one, which must be of the same run, or a new one."""
    batch, observe, plan, *_ = computation
    now = identity(batch, observe, plan, computation.given)

    def check_or_create() -> None:
        if existing is None:
            if not jax.process_index():
                create(path, plan, now, of_parts, others, said)
        elif UNSEEN in now:
            raise ValueError(
                f"{path} cannot be resumed: the torque or observe calls {now[UNSEEN]}, outside the compiled "
                "program, where changes of that code or its numbers cannot be detected. Write it in JAX "
                "instead of a callback, or compute the run anew under another name."
            )
        elif changed := differences(existing.identity, now):
            raise ValueError(
                f"{path} holds another run: {'; '.join(changed)}. Choose another name, or repeat the call that "
                "began that run. A longer run starts from the carry of this one."
            )

    all_succeed(check_or_create)
    return all_succeed(lambda: existing or Store(path))


def _run(
    computation: Computation, file: Memory, values: Arrays, seen: Any, progress: Any
) -> tuple[np.ndarray, int, Carry | None]:
    """Computes what is missing in the file, each process its share; `values` are those that belong to no part.

    It returns `first_bad`, the body-steps computed, and the final carry.
    """
    plan, observe, first = computation.plan, computation.observe, not jax.process_index()
    groups: dict[int, Progress] = {}

    def begin() -> None:
        if first:
            file.write_whole(values)
        for group in plan.groups_of(jax.process_index(), jax.process_count()):
            found = file.checkpoint(group)
            groups[group] = computation.begin(group) if found is None else computation.restored(group, found)
            damaged = file.damaged(group, groups[group].span)
            if damaged:
                raise ValueError(f"{file.path} is damaged: {', '.join(damaged)}. {remedy(group)}")

    def merge() -> None:
        if isinstance(observe, Statistic) and first:
            interval = jnp.asarray(computation.batch.shared[3] * plan.save_every)
            file.write_whole(variables.merged(observe, seen, file.read, interval))

    with ExitStack() as context:
        all_succeed(lambda: context.enter_context(file.writing()) if first else None)
        all_succeed(begin)
        todo = [part for part in plan.parts(groups) if part.span >= groups[part.group].span]
        total = plan.work(plan.parts(groups))
        done = sum(plan.done(group, found.span, found.steps) for group, found in groups.items())
        with reported(progress, total, done) as written:
            all_succeed(lambda: compute_and_write(computation, todo, groups, file, written))
        all_succeed(merge)
        return file.first_bad, total - done, computation.carry(groups)
