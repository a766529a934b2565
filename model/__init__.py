"""The science of the paper: Cosserat rods with pressure as an eigenstrain. No I/O, no clock."""
