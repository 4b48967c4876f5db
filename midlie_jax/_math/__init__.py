"""The mathematics of a step, in a form that XLA fuses; read `components` first."""
