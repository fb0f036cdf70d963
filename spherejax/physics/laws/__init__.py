"""Force laws of one contact: normal, friction, film and elastomer, as in Sect. 4 of the paper.

A law is written once, for one contact, in clear array code; joints are composed of laws.
"""
