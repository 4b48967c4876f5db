"""Bodies in a heat bath: averages and spectra that are known, beside the solvers of diffrax for random equations."""
