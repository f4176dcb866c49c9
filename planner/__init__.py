"""From a continuous problem to a certified trajectory."""
