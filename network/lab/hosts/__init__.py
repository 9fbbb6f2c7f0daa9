"""Stories of a network whose nodes are on hosts of their own: network namespaces of this machine."""
