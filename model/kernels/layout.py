"""Offsets of the quantities in the flat work array of the kernels.

Eight copies of the rod are integrated side by side in lanes: quantity c of lane l stands at 8 c + l. The compiler turns
a loop over l into vector instructions only if it can prove that no two quantities overlap, hence one array with
constant offsets. Parameters have eight lanes too, so that each copy may have its own.

A state is (v, u, q, w, h): strain v and curvature u, linear and angular velocity q and w, all in the section frame, and
the orientation as a quaternion h.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

LANES = 8
STATE = 16
# Per point: history of v, u, q, w, and the arc-length derivative of the history of v, u. For walls with Maxwell
# branches, that derivative is of their past strains, which follow.
HISTORY = 24

NODE = 0
STAGE = NODE + STATE
SLOPE = STAGE + STATE
THIRD = SLOPE + STATE  # the states of RK4's third and fourth stage; the second one is STAGE
FOURTH = THIRD + STATE
WRENCH = FOURTH + STATE  # total internal wrench (n, m) in the section frame
RATE = WRENCH + 6  # its arc-length derivative
LOAD = RATE + 6  # distributed load (f, l) in the section frame
STRAINS = LOAD + 6  # v3, u1, u2 of the state at which the tubes are summed
WALL_FORCES = STRAINS + 3  # moments of the tubes' wall forces: 1, y, -x
TANGENTS = WALL_FORCES + 3  # moments of the tubes' tangent stiffness: 1, x, y, xx, xy, yy
SECANTS = TANGENTS + 6  # moments of their side stiffness: 1, x, y, rr
STIFFNESS_SLOPES = SECANTS + 4  # moments of its derivative by strain: 1, x, y, xx, xy, yy, rrx, rry
SUMS = 21  # all of these moments
OTHER_TRIOS = STIFFNESS_SLOPES + 8  # the same moments, summed over all trios but the last; zero if there is one trio

# Parameters of a lane.
C0 = OTHER_TRIOS + SUMS  # of the time scheme, eq 26
LINE_DENSITY = C0 + 1  # rho A
INERTIA = LINE_DENSITY + 1  # rho J: 11, 22, 12, 33
LAG = INERTIA + 4  # Kelvin-Voigt time tau, as tau / (1 + tau c0)
# Stiffness over (v3, u1, u2): 11, 12, 13, 22, 23, 33, times 1 + tau c0; of a pointwise section, times tau.
AXIAL = LAG + 1
SHEAR = AXIAL + 6  # stiffness over (v1, v2, u3), in the same order
AXIAL_INVERSE = SHEAR + 6
SHEAR_INVERSE = AXIAL_INVERSE + 6
OFFSET = SHEAR_INVERSE + 6  # wrench at zero strain, n1 n2 n3 m1 m2 m3, with that of the pressures
TUBE = OFFSET + 6  # gamma, I_o / A_m of one tube
LAW = TUBE + 2  # constants of its constitutive law
LAW_CONSTANTS = 4
POINTWISE = LAW + LAW_CONSTANTS  # 1 where each tube follows its law at every point, 0 for a constant stiffness
# Tubes are summed in trios; tubes of share 0 complete the last one. Per tube: x, y, free strain, share (1 or 0), and of
# its position xx, xy, yy and xx + yy + 2 I_o / A_m.
TRIO = POINTWISE + 1  # the trio that is summed: the last, or the only one
PER_TUBE = 8
PER_TRIO = 3 * PER_TUBE
STEP_LENGTH = TRIO + PER_TRIO  # step along the arm
# Load at the end of the segment, of the cap or of the coupling to the next one: force (3) and moment (3) in the base
# frame, mass and rotational inertia (3), the point of the section where all these act (3). Then a further, eccentric
# force (3), included in the first, and its point (3).
TIP_LOAD = STEP_LENGTH + 1
ECCENTRIC_FORCE = TIP_LOAD + 13
TIP_LOAD_SIZE = 19
# Where each lane is a perturbed arm (model/kernels/lanes.py): its other parameters.
PAST = TIP_LOAD + TIP_LOAD_SIZE  # history at the stage
OWN_LOAD = PAST + HISTORY  # load per metre beyond the shared one: force and moment, base frame
CENTRE = OWN_LOAD + 6  # centroid of the walls
JOINT = CENTRE + 2  # from the end of the line to the start of that of the next segment, in the section frame
AXIS_SUM = JOINT + 3  # position, first and second derivative of the line
ALL_TRIOS = AXIS_SUM + STATE  # all trios, if there are several


def trios(actuators: int) -> int:
    """Number of trios that hold the tubes."""
    return -(-actuators // 3)


def tubes_at(actuators: int) -> int:
    """Offset of the first tube."""
    return TRIO if actuators <= 3 else ALL_TRIOS


def work_size(actuators: int) -> int:
    """Number of doubles in the work array."""
    return LANES * (ALL_TRIOS if actuators <= 3 else ALL_TRIOS + PER_TRIO * trios(actuators))


def aligned(*shape: int) -> NDArray[np.float64]:
    """An array of zeros aligned to the cache lines, so that the eight lanes of a quantity need one access, not two."""
    line = 8 * LANES
    size = math.prod(shape)
    whole = np.zeros(size + LANES)
    first = -whole.ctypes.data % line // 8
    return whole[first : first + size].reshape(shape)
