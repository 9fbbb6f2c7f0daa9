"""What is wrong with a network, and what to do about it: `blockrobot doctor`."""
