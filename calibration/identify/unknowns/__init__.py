"""The setup of an arm, and the uncertain numbers in it."""
