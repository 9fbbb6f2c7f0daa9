"""The whole story on embedded parts, checked at each step. Must never report a check that was not carried out."""
