"""Real people: a film of pedestrians through the robot's own segmentation, tracks and hiding."""
