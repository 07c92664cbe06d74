"""Find what two pictures have in common: faces, people, and things seen twice."""
