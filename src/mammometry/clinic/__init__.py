"""The clinic. Patients, rigs, visits and people in one place, as a web application.

A clinic is a folder. `config` reads its settings, `site` makes Django of them, `access` says who may open which page.
"""
