"""The plug-in of pytest: tests run their robot in virtual time, break its drives, and look at its shafts."""
