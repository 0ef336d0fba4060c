"""A rig whose description is wrong: is it told, when, and by what name?"""
