"""A page that shows a part in a browser: its skin, what moves on it, its sets. WebGL 2 without a library or a network.

``scene`` has the nouns, ``skin`` makes triangles of faces, ``packing`` writes numbers short, ``page`` writes HTML
around ``viewer.js``, which draws. Rooms that know bodies, findings and jobs make scenes of them.
"""

from morembs.fem.viewer.page import Scene, embed, viewer_head, viewer_page, viewer_section
from morembs.fem.viewer.scene import Feature, Group, Motion, Surface

__all__ = ["Feature", "Group", "Motion", "Scene", "Surface", "embed", "viewer_head", "viewer_page", "viewer_section"]
