"""The site that `make site` builds from README and docs; nothing of it is loaded from a network."""

project = "ekf-companion"
root_doc = "README"
extensions = ["myst_parser"]
myst_heading_anchors = 4
html_theme = "furo"
html_title = project
html_show_copyright = False
html_show_sphinx = False
html_copy_source = False
# Code blocks are what a terminal shows, with a prompt: in no language
highlight_language = "none"
suppress_warnings = ["myst.header"]
