"""From a picture to the pose of the board and the tool centre point."""
