"""What discovery states: the finding as JSON, the extended model, the report.

The search itself is `truepath.discovery`.
"""
