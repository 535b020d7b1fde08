"""One self-contained HTML page that shows a mesh before and after in the browser; WebGL, nothing fetched.

`page.html`, `page.css`, the shaders and the scripts stand in files of their own; `three` is three.js, with its licence.
"""
