"""Asks XLA for one fused loop a step on the CPU, before its first backend starts.

A step has seven or more outputs. Without multi-output fusion XLA's CPU compiler emits one loop for each, every
one of them repeating the whole step: five times slower, and compile times that can explode. The option is read
once, when the first backend starts, so it is set when the package is imported.
"""

import os
import warnings

import jax

_OPTION = "xla_cpu_use_multi_output_fusion"
_CARRIER = "--xla_backend_extra_options="
_KEEP = "MIDLIE_JAX_KEEP_XLA_FLAGS"


def _merged(flags: str) -> str:
    """The flags with the option added to the extra options that are there already."""
    words = flags.split()
    for i, word in enumerate(words):
        if word.startswith(_CARRIER):
            words[i] = f"{word},{_OPTION}=true"
            return " ".join(words)
    return " ".join([*words, f"{_CARRIER}{_OPTION}=true"])


def _decided(flags: str) -> bool | None:
    """What the flags say of the option; None if nothing."""
    if _OPTION not in flags:
        return None
    return not flags.split(_OPTION, 1)[1].lower().startswith("=false")


def _backend_is_up() -> bool:
    return bool(jax._src.xla_bridge.backends_are_initialized())  # noqa: SLF001  # there is no public way to ask


def enable_fusion() -> bool:
    """Sets the option if nobody decided otherwise; returns whether steps will be fused on the CPU."""
    flags = os.environ.get("XLA_FLAGS", "")
    decided = _decided(flags)
    if decided is not None:
        return decided
    if os.environ.get(_KEEP, "") not in ("", "0"):
        return False
    if _backend_is_up():
        warnings.warn(
            "midlie_jax was imported after JAX had started its backend, too late to turn on XLA's CPU multi-output "
            "fusion: steps on the CPU will run several times slower. Import midlie_jax before the first JAX "
            f"computation, or set XLA_FLAGS='{_CARRIER}{_OPTION}=true'.",
            RuntimeWarning,
            stacklevel=3,
        )
        return False
    os.environ["XLA_FLAGS"] = _merged(flags)
    return True


fused = enable_fusion()
