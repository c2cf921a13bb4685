"""Arms and masters that are elsewhere: what carries their messages, and what may pass the border."""
