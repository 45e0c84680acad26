"""Shooting: fits of paths to measurements, with sensitivities and unknown initial states.

Training eliminates the initial states; evaluations without true states test the goodness of fit.
"""
