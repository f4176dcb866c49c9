"""Questions with answers: check, compare, bode, the demo, and the command line."""
