"""Optimal-control motion planning for closed-chain mechanisms: MuJoCo model in, certified trajectory out."""
