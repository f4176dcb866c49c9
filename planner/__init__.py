"""Planning: from a continuous problem to a certified trajectory."""
