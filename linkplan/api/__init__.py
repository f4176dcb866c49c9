"""The public functions, one file for each question.

In: mechanisms, problems, plans or their files, as a caller passes them. Out: results that are saved, drawn and printed
alike. `linkplan` itself offers these names and loads the file when a name is first used.
"""
