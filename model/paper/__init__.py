"""The paper's own formulation, kept so that its results can be reproduced."""
