"""Files: problem files as tables, records, and results that are written completely or not at all.

In: paths, tables, columns, bytes. Out: tables, batches, trajectories, records, and result folders.
"""
