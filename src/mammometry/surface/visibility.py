"""Where a world point stands with respect to what one view saw: the only place where the two are compared.

The paper uses the same words for opposite things. Section 2.5 calls a cube *visible* when it lies in front of the
surface; section 2.6.1 calls a point *visible* when it lies behind the other range image's surface. Ours:

================  ================  =====================  =======================================================
label             section 2.5       section 2.6.1          meaning
================  ================  =====================  =======================================================
``IN_FRONT``      visible           invisible              nearer than the seen surface: the view looks through it
``BEHIND``        invisible         visible                further than the seen surface: hidden from the view
``OVERLAPPING``   on surface        overlapping            within ε of the seen surface
``OUTSIDE``       (not said)        unprocessed            outside the image, behind the camera, or no datum there
================  ================  =====================  =======================================================
"""

from enum import IntEnum


class Label(IntEnum):
    """Position of a point relative to the surface that a view saw."""

    OUTSIDE = 0
    """No datum there: the view says nothing."""
    IN_FRONT = 1
    """Between camera and seen surface: free space to that view."""
    OVERLAPPING = 2
    """Within ε of the seen surface."""
    BEHIND = 3
    """Beyond the seen surface: hidden from that view."""
