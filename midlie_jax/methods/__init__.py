"""One step of every integrator: equations of motion, flights, schemes, implicit and Runge-Kutta methods."""
