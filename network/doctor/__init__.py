"""`blockrobot doctor`: what is wrong with a network, and remedies."""
