"""The keys of problem and batch files: each one's type, range, default and meaning, said once.

In: tables as TOML has them. Out: the same as typed sections, or a refusal in one line; a JSON Schema and a table of keys.
"""
