"""The control loop in a process of its own: `parent` is the page's side, `child` the other."""
