"""The parts of the page, one file each; `page.PANELS` says where they stand."""
