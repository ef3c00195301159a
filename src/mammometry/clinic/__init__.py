"""The clinic: patients, rigs, visits and people in one place, as a web application.

A clinic is a folder. `config` reads its settings, `site` configures Django, `access` controls who may open which page.
"""
