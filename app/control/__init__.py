"""The control loop: one tick (`engine`), its thread (`loop`), and what crosses between threads."""
