"""Settings of Sphinx for `make docs`; make_site.py puts it beside the pages."""

project = 'av_rig'
author = copyright = 'The av_rig maintainers'  # noqa: A001  Sphinx names it so
extensions = ['myst_parser', 'sphinx.ext.autodoc', 'sphinx.ext.napoleon']
myst_enable_extensions = ['dollarmath', 'html_image']
myst_heading_anchors = 4
root_doc = 'index'
html_theme = 'furo'
html_title = 'av_rig'
autodoc_member_order = 'bysource'
autodoc_typehints = 'none'
napoleon_custom_sections = [('Parameters', 'params_style'), ('Attributes', 'params_style')]
suppress_warnings = ['autodoc.import_object', 'docutils', 'misc.highlighting_failure', 'ref.python']
