"""The keys of problem and batch files, each with its type, range, default and meaning.

In: tables as TOML has them. Out: typed sections, or a refusal in one line; a JSON Schema and a table of keys.
"""
