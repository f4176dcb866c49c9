"""The presentation of results: tables, figures and pages shared by the studies.

In: plans, mechanisms, results. Out: text for a terminal, matplotlib figures, HTML.
"""
