"""What the page draws in the scene, one module a part."""
