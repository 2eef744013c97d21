"""The documentation's site, made by ``make docs``."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent / '_site'))

from taxinet_ros.version import __version__

project = 'taxinet_ros'
author = 'the authors of taxinet_ros'
version = release = __version__
extensions = [
    'myst_parser', 'sphinx.ext.autodoc', 'sphinx.ext.napoleon', 'sphinx_copybutton', 'site_pages',
]
exclude_patterns = ['_site']
nitpicky = True
smartquotes = False  # two hyphens begin an option
# Names of other packages, whose documentation a build without network cannot look up, and of ours
# that are not public.
nitpick_ignore_regex = [
    (r'py:.*', r'(?!taxinet_ros\.).*'),
    (r'py:.*', r'taxinet_ros\.(?!api\.)[a-z_]+\..*'),
]

myst_enable_extensions = ['deflist', 'colon_fence']
myst_heading_anchors = 4

autodoc_member_order = 'bysource'
autodoc_typehints = 'none'  # the signature has them; napoleon has the words
napoleon_numpy_docstring = False
napoleon_use_ivar = True
toc_object_entries = False  # the page has a heading for each name
python_use_unqualified_type_names = True

html_theme = 'furo'
html_title = f'taxinet_ros {__version__}'
html_static_path = ['_site/static']
html_css_files = ['site.css']
html_copy_source = False
html_show_sphinx = False
html_show_copyright = False
# Sphinx's own style is legible in both themes; furo switches between them.
pygments_style, pygments_dark_style = 'friendly', 'monokai'
copybutton_exclude = '.linenos, .gp, .go'
