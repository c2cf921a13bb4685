"""Arms and masters that are elsewhere: what carries their messages, what passes the border."""
