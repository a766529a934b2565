"""Where each quantity stands in the kernels' one flat work array.

The value and seven perturbed runs are integrated side by side: quantity number c of run l stands at 8 c + l. The
compiler turns a loop over l into vector instructions only if it can see that no two quantities overlap, hence one array
with constant offsets. Parameters have eight lanes too, so that a run may also differ by a parameter.

A state is (v, u, q, w, h): strain v and curvature u, linear and angular velocity q and w, all in the section's own
frame, and the orientation as a quaternion h.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

LANES = 8
STATE = 16
# Per point: history of v, u, q, w, and the arc-length derivative of that of v, u. Where the walls have branches, that
# derivative is of their past strains, which follow.
HISTORY = 24

NODE = 0
STAGE = NODE + STATE
SLOPE = STAGE + STATE
THIRD = SLOPE + STATE  # the states of RK4's third and fourth stage; the second one is STAGE
FOURTH = THIRD + STATE
WRENCH = FOURTH + STATE  # total internal wrench (n, m) in the section frame
RATE = WRENCH + 6  # its arc-length derivative
LOAD = RATE + 6  # distributed load (f, l) in the section frame
STRAINS = LOAD + 6  # v3, u1, u2 of the state whose tubes are summed
PULLS = STRAINS + 3  # moments of the tubes' wall forces: 1, y, -x
TANGENTS = PULLS + 3  # moments of the tubes' tangent stiffness: 1, x, y, xx, xy, yy
SECANTS = TANGENTS + 6  # moments of their side stiffness: 1, x, y, rr
CHANGES = SECANTS + 4  # moments of its derivative by strain: 1, x, y, xx, xy, yy, rrx, rry
SUMS = 21  # all of these moments
OTHERS = CHANGES + 8  # the same moments of all trios but the last; nothing where there is one only

# Parameters of a run.
C0 = OTHERS + SUMS  # of the time scheme, eq 26
LINE_DENSITY = C0 + 1  # rho A
INERTIA = LINE_DENSITY + 1  # rho J: 11, 22, 12, 33
LAG = INERTIA + 4  # Kelvin-Voigt time tau, as tau / (1 + tau c0)
# Stiffness over (v3, u1, u2): 11, 12, 13, 22, 23, 33, times 1 + tau c0; of a pointwise section, times tau.
AXIAL = LAG + 1
SHEAR = AXIAL + 6  # stiffness over (v1, v2, u3), in the same order
AXIAL_INVERSE = SHEAR + 6
SHEAR_INVERSE = AXIAL_INVERSE + 6
OFFSET = SHEAR_INVERSE + 6  # what the pressures and the strain at rest add to the wrench: n1 n2 n3 m1 m2 m3
TUBE = OFFSET + 6  # gamma, I_o / A_m of one tube
LAW = TUBE + 2  # constants of its law
LAW_CONSTANTS = 4
# Tubes come in trios, the last filled up with tubes of no share. Per tube: x, y, free strain, share (1, or 0), and of
# its place xx, xy, yy and xx + yy + 2 I_o / A_m.
TRIO = LAW + LAW_CONSTANTS  # the trio being summed: the last, or the only one
PER_TUBE = 8
PER_TRIO = 3 * PER_TUBE
STRIDE = TRIO + PER_TRIO  # step along the arm
# What hangs on the tip. Force and moment in the base frame, the mass and rotational inertia (3) of a cap that resists
# acceleration, where all this is in the section (3). Last the part of the force that pulls elsewhere, and where (3).
END = STRIDE + 1
PULL = END + 13
HANGS = 19  # numbers of this
# Where each lane is an arm of its own (model/kernels/lanes.py), what else they differ in.
PAST = END + HANGS  # history at the stage
WEIGHT = PAST + HISTORY  # load per metre beyond the one that all share: force and moment, base frame
CENTRE = WEIGHT + 6  # centroid of the walls
GATHER = CENTRE + 2  # sum of a step along the arm
MORE = GATHER + STATE  # where there are several trios, all of them


def trios(actuators: int) -> int:
    """How many trios hold the tubes."""
    return -(-actuators // 3)


def tubes_at(actuators: int) -> int:
    """Where the first tube stands."""
    return TRIO if actuators <= 3 else MORE


def work_size(actuators: int) -> int:
    """Doubles in the work array."""
    return LANES * (MORE if actuators <= 3 else MORE + PER_TRIO * trios(actuators))


def aligned(*shape: int) -> NDArray[np.float64]:
    """An array of zeros whose lanes each fill one line of the processor's cache; elsewhere every access costs two."""
    line = 8 * LANES
    size = math.prod(shape)
    whole = np.zeros(size + LANES)
    first = -whole.ctypes.data % line // 8
    return whole[first : first + size].reshape(shape)
