"""`linkplan demo`: all studies of the Optimus knee in one folder; and the gallery of mechanisms."""
