"""The packages we are compared with, each as a program that uses the fastest documented API."""
