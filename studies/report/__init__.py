"""Results as one page: a document of sections and blocks, and the self-contained HTML file that shows it.

In: plans, comparisons, loops, checks; or the folders that they were saved in. Out: `report.html`, which opens offline.
"""
