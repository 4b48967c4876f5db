"""The checks of arguments, made before anything is traced, and types that are checked at run time."""
