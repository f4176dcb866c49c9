"""Models of mechanisms: MJCF files, symbolic tree dynamics, loop closure, reduced dynamics, actuators and assembly."""
