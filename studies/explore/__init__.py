"""A problem explored by sliders on a page of this machine. In: a problem. Out: certified, tracked plans, a problem file.

The page is served on 127.0.0.1 only, at an address with a secret token.
"""
