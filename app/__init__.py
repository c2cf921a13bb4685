"""The interactive sandbox: control thread, session, command line and page.

Nothing is imported here, so that `import app.settings` stays cheap.
"""
