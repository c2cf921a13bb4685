"""3D Slicer and others over OpenIGTLink: transforms in and out, registration, structures."""
