"""The part of `make fuzz`: arguments that make no sense, of which every one must get a ValueError or be accepted.

One to three arguments of a sensible call are replaced by something else: another type, shape or dtype, a number out of
range, a name that does not exist. Whatever is raised that is no ValueError, or from inside XLA, is a failure. What a
torque itself raises is left to it.
"""

import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import strategies as st

import midlie_jax as ml

NUMBERS = [0, 1, -1, 2, 0.1, -0.5, 1e30, 1e300, -0.0, float("nan"), float("inf"), True, None, "0.1", 1j, 2**31, 2**70]
ARRAYS = [
    np.array(value, dtype)
    for value in (0.1, [0.1], [1, 2, 3], [1, 0, 0, 0], [[1, 2, 3]], [[1, 0, 0, 0], [0, 1, 0, 0]], [], [0, 0, 0])
    for dtype in (np.float64, np.float32, np.float16, np.int32, bool, complex)
]
OBJECTS = [object(), "LIEMID[EA]", [1, 2, "3"], [[1, 2], [3]], {}, {"a": 1.0}, (), lambda t, state: 1.0]
STATES = [
    ml.RigidState([1.0, 2.0, 3.0], [1.0, 0.0, 0.0, 0.0]),
    ml.RigidState(jnp.ones((2, 3), "float32"), jnp.tile(jnp.array([1.0, 0, 0, 0], "float32"), (2, 1))),
    ml.MomentumState([1.0, 2.0, 3.0]),
    ml.DirectionState([1.0, 2.0, 3.0], [0.0, 0.0, 1.0]),
    ml.ParticleState([1.0, 2.0], [0.0, 1.0]),
]
TORQUES = [
    None,
    ml.torques.HeavyTop(1.0),
    ml.torques.HeavyTop(np.ones(2)),
    ml.torques.Damping(0.1),
    lambda t, state: state.momentum,
    lambda t, state: jnp.ones(2),
    lambda t, state: np.ones(3, np.float32),
    lambda t, state: None,
    lambda t, state: jnp.cross(state.attitude[1:], state.momentum) if t > 0 else state.momentum,
]
BODIES = [
    ml.RigidBody([1.0, 2.0, 2.5]),
    ml.RigidBody(np.array([[1.0, 2, 2.5], [1, 1, 1]])),
    ml.TensorBody(np.diag([1.0, 2.0, 2.5])),
    ml.Particles([1.0, 2.0]),
]
NAMES = ["LIEMID[EA]", "liemid[ea]", "JACOBI", "SYMMETRIC[EA]", "Verlet", "RK4", "JACOBI[RK4]", "", "[", "LIEMID[EA"]
ANYTHING = st.sampled_from([*NUMBERS, *ARRAYS, *OBJECTS, *STATES, *TORQUES, *BODIES, *NAMES])

CALLS = {
    "integrate": (ml.integrate, {"start": STATES[0]}),
    "ensemble": (ml.ensemble, {"start": STATES[1], "chunk": 1, "torque_axes": "auto"}),
}
SENSIBLE = {
    "method": "LIEMID[EA]",
    "body": BODIES[0],
    "torque": None,
    "dt": 0.1,
    "steps": 2,
    "save_every": 1,
    "t0": 0.0,
    "first_step": 0,
}
LIKELY = {"body": BODIES, "torque": TORQUES, "start": STATES, "method": NAMES, "motion": STATES, "name": NAMES}
PARTS = {
    "RigidBody": (ml.RigidBody, {"moments": [1.0, 2.0, 2.5]}),
    "TensorBody": (ml.TensorBody, {"tensor": np.eye(3)}),
    "RigidState": (ml.RigidState, {"momentum": [1.0, 2.0, 3.0], "attitude": [1.0, 0.0, 0.0, 0.0]}),
    "DirectionState": (ml.DirectionState, {"momentum": [1.0, 2.0, 3.0], "direction": [0.0, 0.0, 1.0]}),
    "HeavyTop": (ml.torques.HeavyTop, {"mgl": 1.0, "axis": (0.0, 0.0, 1.0)}),
    "Prescribed": (ml.torques.Prescribed, {"function": lambda t: jnp.ones(3)}),
    "Held": (ml.torques.Held, {"values": np.ones((2, 3)), "dt": 0.1, "t0": 0.0}),
    "Pulses": (ml.torques.Pulses, {"starts": [0.0, 1.0], "width": 0.1, "torque": [0.0, 0.0, 1.0]}),
    "ReactionWheels": (ml.spacecraft.ReactionWheels, {"momentum": lambda t: jnp.ones(3)}),
    "Sum": (lambda one, two: ml.torques.Sum(one, two), {"one": TORQUES[1], "two": TORQUES[3]}),
    "method": (ml.method, {"name": "JACOBI", "scheme": "EA"}),
    "Scheme": (ml.schemes.Scheme, {"name": "mine", "order": 1, "stages": (("kick", 1.0), ("flight", 1.0))}),
    "energy": (ml.observe.energy, {"body": BODIES[0], "torque": TORQUES[1], "motion": STATES[0], "t": None}),
    "velocity": (ml.observe.spatial_angular_velocity, {"body": BODIES[0], "state": STATES[0]}),
    "PDControl": (ml.spacecraft.PDControl, {"target": [1.0, 0, 0, 0], "proportional": 1.0, "derivative": 1.0}),
    "KeplerOrbit": (ml.orbits.KeplerOrbit, {"position": [1.0, 0, 0], "velocity": [0.0, 1, 0], "mu": 1.0}),
}


@st.composite
def calls(draw):
    """A function's name and its arguments."""
    name = draw(st.sampled_from([*CALLS, *CALLS, *PARTS]))
    arguments = {**SENSIBLE, **CALLS[name][1]} if name in CALLS else dict(PARTS[name][1])
    for key in draw(st.lists(st.sampled_from(sorted(arguments)), min_size=1, max_size=3, unique=True)):
        arguments[key] = draw(st.one_of(ANYTHING, st.sampled_from(LIKELY[key])) if key in LIKELY else ANYTHING)
    return name, arguments


def check_call(call) -> None:
    """Raises whatever the function raises, unless it is a ValueError."""
    name, arguments = call
    function = (CALLS | PARTS)[name][0]
    if isinstance(arguments.get("steps"), int) and arguments["steps"] > 10**6:
        arguments["steps"] = 4  # sensible, and long
    try:
        jax.block_until_ready(function(**arguments))
    except ValueError as error:
        if "XLA" in str(error) or "xla" in type(error).__module__:
            raise AssertionError(f"{name}: {error}") from error
