"""The whole story on embedded parts, checked at each step."""
