"""Names and semantics of CRTK, the Collaborative Robotics Toolkit, whatever carries them."""
