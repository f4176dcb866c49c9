"""What the machine is: MJCF models, tree dynamics, loop closure, reduction, assembly."""
