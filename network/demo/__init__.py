"""The demonstration of the whole system on embedded stores, checked at each step."""
