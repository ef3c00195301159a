"""Names of the sources of a volume's error, and how far two volumes share them."""

MOVEMENT = "movement"
AXIS = "trunk's axis"
HIDDEN_FOLD = "hidden fold"
SCALE, WALL, BOUNDARY = "scale", "chest wall", "boundary"
"""Names of sources in results."""
WALL_ACROSS_POSES_U95_MM = 2.5
"""Half-width for the change of one breast between two captures in different poses, mm."""
WALL_FIT_U95_MM = WALL_ACROSS_POSES_U95_MM / 2**0.5
"""Half-width of the difference between one fitted wall and its definition, mm: two captures of one breast in different
poses differ by the errors of both walls."""
WALL_SAME_POSE_U95_MM = 1.2
"""Half-width for the change of one breast between two captures in the same pose, mm."""
WALL_SIDES_U95_MM = 1.9
"""Half-width of the error that the walls of both sides of one capture do not share, mm per side. On real women the
error of right minus left over the base was below 2.6 mm in 95 %: 1.84 mm per side. Virtual torsos have 0.93
(docs/decisions/0029)."""
WALL_CORRELATION = 0.75
"""Correlation of the errors of both sides' walls in one capture. On real women the error of a side was below 3.7 mm in
95 %, and that of right minus left below 2.6 mm: 1 − 2.6² / (2 × 3.7²). Virtual women have 0.8 (docs/decisions/0046)."""
BOUNDARY_CORRELATION = 0.5
"""Correlation of the boundaries' contributions to the errors of both volumes of one capture. On 34 virtual women it was
0.81 (95 % of bootstrap samples: 0.55 to 0.95). Drawn curves are taken as independent: two ratings differ as much by one
person as by two (docs/decisions/0046)."""
