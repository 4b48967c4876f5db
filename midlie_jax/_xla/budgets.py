"""The measured limits by which a run is divided for XLA: its loops, prepared inputs, chunks and kept states.

`python benchmarks/compiler_options.py limits` times typical runs with each limit at half, as it is, and doubled, and
`tests/test_compiled.py` counts the loops. How many flights fit one loop is a property of the flight, `per_loop`.
"""

# ---- the torque: scalars or arrays, in the loop of the step or in its own ----

LONG_TORQUE = 150  # operations from which a torque, or a stage of a tableau, has its own loops
SCALAR_ENTRIES = 64  # arrays with more entries are not split into scalars
# Pairs (operations, ratio). A function is evaluated on arrays if, for one pair, it has more operations on scalars than
# the first number, and more of them per operation on arrays than the second.
ON_ARRAYS = ((100, 2.5), (30, 4.0))
UNROLLED_BODIES = 3  # coupled bodies unrolled into scalars; four are faster side by side
UNROLLED_OPERATIONS = 2500  # of the torque on them; more take over ten seconds to compile
WRITTEN_ROWS = 16  # of a sum over a table, such as the facets of a surface, written out in one loop

# ---- the loops of a step ----

# The largest number of operations in a loop over the batch. XLA divides longer loops and repeats their work: with 4000
# operations in one loop, a step takes 40 times the time of two loops of half that length. On a GPU longer kernels
# are also divided.
LOOP_OPERATIONS, KERNEL_OPERATIONS = 2800, 2000
# Operations of a derivative for each of a step, by `benchmarks/speed.py gradient`: by the state and a few parameters,
# or by more than these.
DERIVATIVE_OPERATIONS, DERIVATIVE_OPERATIONS_OF_MANY, FEW_PARAMETERS = 2, 4, 4
# Outputs of a loop in a derivative. XLA does not fuse a value that more outputs read, and repeats the loop for it.
LOOP_OUTPUTS = 22
LOOP_STAGES = 2  # stages of a tableau whose derivative fits one loop under any torque
KERNEL_EVALUATIONS = 16  # of a simple torque that fit one kernel
VECTOR_NUMBERS = 16  # of a leaf; with fewer, a loop without vectors is not slower
VECTOR_BODIES = 4  # from this number a vectorised step is faster, although its steps are launched one by one

# ---- the loop over steps ----

# A smaller number of steps between saved states is part of the program. Otherwise saving the states, and the loop over
# the last few steps between two of them, would take longer.
COUNTED_STEPS = 32
CHECKED_STEPS = 32  # between two checks that every body with variable steps has reached the end
# Approximate steps per iteration on an accelerator, where the host checks after each iteration whether to continue.
DEVICE_STEPS = 64
PREPARED_ROWS = 64  # rows of the inputs that all bodies share, computed at once
PREPARED_STEPS = 64  # the shortest table of them; one program serves tables up to 4 times longer
PREPARED_BYTES = 2**26  # of a table; larger ones are recomputed in every chunk

# ---- the bodies of a chunk ----

CHUNK = 256  # bodies moved at once on one core
# The same for a state of more numbers than `LARGE_STATE`. Its arrays then do not begin at multiples of 2 KiB, where
# they would share a few sets of the first-level cache (`benchmarks/speed.py kinds`).
LARGE_CHUNK, LARGE_STATE = 376, 12
CHUNK_NUMBERS = 26 * LARGE_CHUNK  # of states moved at once; only a few replicas of many coupled bodies
VECTOR = 8  # bodies: chunks whose size is not a multiple of this took up to 4 times longer

# ---- the states that a reverse derivative keeps ----

# Counts of numbers per body. The states that a derivative keeps are written to memory and read again. If the kept
# states of a few hundred bodies fit the last-level cache, this is faster than recomputing the steps; otherwise it is
# slower. The steps between two kept states should fit the second-level cache (`benchmarks/speed.py gradients`).
KEPT_ALL, KEPT_BETWEEN = 10_240, 1024
SHORTEST_BETWEEN = 8  # steps between two kept states
REVERSED_INTERVALS = 16  # between the states that a reversible run keeps
