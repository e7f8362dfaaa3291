"""The study of real pairs: do random starts of one radiograph end at one answer, and does the verdict know?"""
