"""The versions of the packages that compute."""

from importlib.metadata import PackageNotFoundError, version


def versions() -> dict[str, str]:
    """The versions of midlie_jax, jax and jaxlib, by the names of these packages."""
    return {name: _version(name) for name in ("midlie_jax", "jax", "jaxlib")}


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
