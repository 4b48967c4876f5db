"""Checks of arguments, made before tracing, and types that are checked at run time."""
