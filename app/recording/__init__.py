"""A session in one file: `format` says what is in it, and no file is trusted.

`write.Recorder` makes a file, `read.read` gives back what is in one.
"""
