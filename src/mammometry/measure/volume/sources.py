"""Sources of a volume's error, and what two volumes share of them.

Nothing is computed here: a difference of two stored volumes needs no surface.
"""

MOVEMENT = "movement"
AXIS = "trunk's axis"
HIDDEN_FOLD = "hidden fold"
SCALE, WALL, BOUNDARY = "scale", "chest wall", "boundary"
"""Names of sources, as results state them."""
WALL_ACROSS_POSES_U95_MM = 2.5
"""Half-width for the change of one breast between two captures in different poses, mm."""
WALL_FIT_U95_MM = WALL_ACROSS_POSES_U95_MM / 2**0.5
"""Half-width by which one fitted wall may lie off the surface that its definition means, mm. Two captures of one breast
in different poses differ by both walls' shares."""
WALL_SAME_POSE_U95_MM = 1.2
"""Half-width for the change of one breast between two captures in the same pose, mm."""
WALL_SIDES_U95_MM = 1.9
"""Half-width, mm for each side, of what walls of both sides of one capture do not share. On real women right less left
over the base was off by less than 2.6 mm in 95 %, which is 1.84 mm for each side. Our torsos have .93. An earlier
synthetic family had 3.4. docs/decisions/0029."""
WALL_CORRELATION = 0.75
"""Correlation of the errors of both sides' walls in one capture. On real women each side was off by less than 3.7 mm in
95 %, and right less left by less than 2.6 mm: 1 - 2.6² / (2 × 3.7²). Virtual women have .8. docs/decisions/0046."""
BOUNDARY_CORRELATION = 0.5
"""Correlation of what two boundaries found in one capture add to the errors of both volumes, over their terms. On 34
virtual women it was .81, in 95 % of bootstrap draws .55 to .95. Of curves that persons draw nothing is known to be
shared: two ratings by one person lie as far apart as by two. docs/decisions/0046."""
