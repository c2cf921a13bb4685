"""People take a study: a front page, and for each a process with a session and a page."""
