"""The author's kit: what one needs to write, test and look into contracts. Must never be needed to run a chain."""
