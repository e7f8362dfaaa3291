"""Studies of regtorch, run from a checkout.

A study is a package. Its command is the package's ``__main__`` or a file here; the other files here are commands that
draw from tables alone. A study imports ``common`` and no other study.
"""
