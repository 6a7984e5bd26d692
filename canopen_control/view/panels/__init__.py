"""Panels of the page, one module each; `view_app.PANELS` determines their order."""
