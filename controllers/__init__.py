"""From a reference to a torque, and the MuJoCo closed loop that tries it."""
