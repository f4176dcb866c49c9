"""The report of a folder that linkplan wrote.

In: a folder. Out: its saved document, or one made from its plan or record.
"""
