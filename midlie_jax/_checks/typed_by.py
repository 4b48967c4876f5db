"""`TypedBy`: makes a `NamedTuple` generic, like `typing.Generic`, but allows annotations checked at run time."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from typing import Generic as TypedBy
else:

    class TypedBy:
        """`class Path(NamedTuple, TypedBy[S])` is generic to type checkers, and a plain named tuple at run time.

        beartype rejects every annotation with a `NamedTuple` that has `typing.Generic` among its bases. A plain named
        tuple can be subscripted because tuples can: for the annotation `Path[RigidState]`, beartype checks for `Path`.
        """

        def __class_getitem__(cls, parameters: Any) -> "TypedBy":
            return cls()

        def __mro_entries__(self, bases: tuple[Any, ...]) -> tuple[()]:
            return ()


__all__ = ["TypedBy"]
