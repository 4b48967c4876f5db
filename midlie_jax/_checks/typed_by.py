"""`TypedBy`: what `typing.Generic` is to a class, for a `NamedTuple` whose annotations are checked at run time, too."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from typing import Generic as TypedBy
else:

    class TypedBy:
        """`class Path(NamedTuple, TypedBy[S])` is generic to type checkers, and a plain named tuple at run time.

        beartype refuses every annotation with a `NamedTuple` that has `typing.Generic` among its bases. A plain one can
        be subscripted, too, because tuples can: `Path[RigidState]` is an annotation in which beartype checks `Path`.
        """

        def __class_getitem__(cls, parameters: Any) -> "TypedBy":
            return cls()

        def __mro_entries__(self, bases: tuple[Any, ...]) -> tuple[()]:
            return ()


__all__ = ["TypedBy"]
