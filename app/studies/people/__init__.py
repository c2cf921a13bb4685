"""User studies: a person takes part on a page, and what was measured is analysed."""
