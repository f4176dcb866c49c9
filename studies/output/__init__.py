"""The presentation of results: documents of texts, tables, plots and bars, and their renderers.

In: plans, mechanisms, values of studies. Out: the same as plain text, on a terminal, as a figure, as one HTML page.
"""
