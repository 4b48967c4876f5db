"""One step of each integrator: equations of motion, flights, schemes, implicit and Runge-Kutta methods."""
