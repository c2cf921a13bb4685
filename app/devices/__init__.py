"""What moves and is moved: masters that an operator holds, and arms. See `protocols`."""
