"""The command line: arguments in, studies run, results printed and written, an exit code out."""
