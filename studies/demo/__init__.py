"""`linkplan demo`: the whole path on the Optimus knee in one folder; and the gallery of mechanisms."""
