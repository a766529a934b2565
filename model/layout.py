"""Where each quantity stands in the kernels' one flat work array.

The value and seven perturbed runs are integrated side by side: quantity number c of run l stands at 8 c + l. The
compiler turns a loop over l into vector instructions only if it can see that no two quantities overlap, hence one array
with constant offsets. Parameters have eight lanes too, so that a run may also differ by a parameter.

A state is (v, u, q, w, h): strain v and curvature u, linear and angular velocity q and w, all in the section's own
frame, and the orientation as a quaternion h.
"""

from __future__ import annotations

LANES = 8
STATE = 16
HISTORY = 18  # per point: history of v, u, q, w, and the arc-length derivative of that of v, u

NODE = 0
STAGE = NODE + STATE
SLOPE = STAGE + STATE
SUM = SLOPE + STATE
WRENCH = SUM + STATE  # total internal wrench (n, m) in the section frame
RATE = WRENCH + 6  # its arc-length derivative
LOAD = RATE + 6  # distributed load (f, l) in the section frame
TANGENTS = LOAD + 6  # moments of the tubes' tangent stiffness: 1, x, y, xx, xy, yy
SECANTS = TANGENTS + 6  # moments of their side stiffness: 1, x, y, rr
CHANGES = SECANTS + 4  # moments of its derivative by strain: 1, x, y, xx, xy, yy, rrx, rry

# Parameters of a run.
CURRENT = CHANGES + 8  # the actuator being summed: x, y, free strain
C0 = CURRENT + 3  # of the time scheme, eq 26
LINE_DENSITY = C0 + 1  # rho A
INERTIA = LINE_DENSITY + 1  # rho J: 11, 22, 12, 33
DAMPING = INERTIA + 4  # Kelvin-Voigt time
AXIAL = DAMPING + 1  # stiffness over (v3, u1, u2): 11, 12, 13, 22, 23, 33
SHEAR = AXIAL + 6  # stiffness over (v1, v2, u3), in the same order
AXIAL_INVERSE = SHEAR + 6
SHEAR_INVERSE = AXIAL_INVERSE + 6
OFFSET = SHEAR_INVERSE + 6  # what the pressures and the strain at rest add to the wrench: n1 n2 n3 m1 m2 m3
TUBE = OFFSET + 6  # a1, a2, gamma, I_o / A_m of one tube
ACTUATORS = TUBE + 4  # per actuator: x, y, free strain
PER_ACTUATOR = 3

LINEAR = 0
POINTWISE = 1


def work_size(actuators: int) -> int:
    """Doubles in the work array."""
    return LANES * (ACTUATORS + PER_ACTUATOR * actuators)
