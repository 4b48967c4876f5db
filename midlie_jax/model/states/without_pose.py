"""`WithoutPose`: the methods of a state that holds a momentum alone."""

from typing import Any, ClassVar

from jax import Array

from ..._math import components as cp


class WithoutPose:
    """Mixin for states whose pose is ()."""

    has_pose: ClassVar[bool] = False

    @staticmethod
    def rotate(pose: tuple[()], increment: Any) -> tuple[()]:
        del increment
        return pose

    @staticmethod
    def turn(pose: tuple[()], increment: Any, no_step: Array) -> tuple[()]:
        del increment, no_step
        return pose

    @staticmethod
    def shift(pose: tuple[()], change: tuple[()], no_step: Array) -> tuple[()]:
        del change, no_step
        return pose

    @staticmethod
    def rate(pose: tuple[()], velocity: cp.Vector) -> tuple[()]:
        del velocity
        return pose
