"""`blockrobot bench hiding`: what attackers recover of the people whom the robot hides."""
