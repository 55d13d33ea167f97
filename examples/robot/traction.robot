*** Comments ***
pip install robotframework, then: robot --outputdir out --xunit report.xml examples/robot

*** Settings ***
Documentation    The gateway as a Robot Framework suite, on the virtual clock.
Library          Traction.py

*** Variables ***
${SCENARIO}      ${CURDIR}/../regression/hil_wet_rail.toml

*** Test Cases ***
A Wheel On Leaves Is Reported
    Run Scenario    ${SCENARIO}
    All Expectations Should Hold
    Flag Should Become    adhesion    AdhesionLost    drive=3    after_s=3.0    within_ms=100

No Other Wheel Is Accused
    Run Scenario    ${SCENARIO}
    Flag Should Never Become    adhesion    AdhesionLost    drive=1
    Flag Should Never Become    adhesion    AdhesionLost    drive=2
    Adhesion Should Be Known    90
