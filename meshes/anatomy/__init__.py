"""Anatomy as named structures: from label maps, files, folders and built-in sets."""
