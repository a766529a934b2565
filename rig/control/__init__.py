"""The control cycle as pure step functions, without a clock."""
