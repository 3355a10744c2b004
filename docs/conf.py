"""How Sphinx makes the site of these pages: ``make docs``."""

from morembs.version import VERSION

project = "morembs"
author = copyright = "morembs developers"
version = release = VERSION

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_gallery.gen_gallery"]
exclude_patterns = ["start/tutorials"]  # the gallery makes pages of them, in built/tutorials
html_theme = "furo"
html_title = f"morembs {VERSION}"

# Headings have the anchors that GitHub gives them, so that links work in both places.
myst_heading_anchors = 4
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
autodoc_member_order = "bysource"

sphinx_gallery_conf = {
    "examples_dirs": ["start/tutorials"],
    "gallery_dirs": ["built/tutorials"],
    "filename_pattern": r"\.py$",
    "within_subsection_order": "FileNameSortKey",
    "abort_on_example_error": True,
    "show_memory": False,
    "show_signature": False,
    "download_all_examples": False,
    "write_computation_times": False,
}
