"""Recording of a session in one file: `format` describes it, `write` and `read` do the I/O.

Every file that is read is validated.
"""
