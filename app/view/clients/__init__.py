"""What belongs to one browser: its camera, input, name, Escape key, pictures, uploads."""
