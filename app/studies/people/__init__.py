"""User studies: people, or simulated operators, do trials under conditions in balanced order."""
