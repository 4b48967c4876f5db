"""How each integrator takes a step: equations of motion, flights, schemes, implicit and Runge-Kutta methods."""
