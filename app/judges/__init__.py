"""Independent checks of the rule's guarantees; they share no code with the rule."""
