"""Problems, batches and plans on disk.

In: TOML tables and folders. Out: `PlanningProblem`, `Batch` and `Plan` values, and their files, written whole or not at all.
"""
