"""The presentation of results: documents of texts, tables, plots and bars, and what renders them.

In: plans, mechanisms, values of studies. Out: the same as plain text, on a terminal, as a figure, as one HTML page.
"""
