"""Panels of the page, one module each; `page.PANELS` has their order."""
