#!/usr/bin/env bash
# canmatrix 1.3.3 (PyPI) and an EDS with limits, converted to a DBC.
#
# Input: an EDS whose TPDO 1 maps 0x606C, velocity actual value, INTEGER16. The object has LowLimit=-3000 and
# HighLimit=3000. canconvert makes a DBC of it for node 5, and one of the same file without the limits.
# Seen: SG_ Velocity_actual_value : 0|16@1- (1,-3000) [-3000|3000]. The lower limit is taken for the offset as well: the
# PDO of a motor at rest reads as -3000. Without the limits the line ends in (1,0).
# One would guess (1,0) [-3000|3000]: limits bound a value, and do not move it.
# Why it matters: the DBC is made to look at values. A value that is not limited in the EDS is right, so that the file
# seems to be good, and every limited one is wrong by its own lower limit.
# Exit code 0 while that is so, 1 when it has changed, 2 when the package cannot be installed.
set -u
folder=$(mktemp -d) || exit 2
trap 'rm -rf "$folder"' EXIT
cd "$folder" && python3 -m venv venv || exit 2
venv/bin/pip install -q canmatrix==1.3.3 canopen==2.4.1 attrs==25.4.0 click==8.3.1 2>/dev/null || exit 2

eds() { # the lines of the limits
    cat <<EDS
[DeviceInfo]
VendorName=v
ProductName=drive
[MandatoryObjects]
SupportedObjects=0
[OptionalObjects]
SupportedObjects=3
1=0x1800
2=0x1A00
3=0x606C
[1800]
ParameterName=TPDO 1
ObjectType=0x9
SubNumber=3
[1800sub0]
ParameterName=Highest sub-index
ObjectType=0x7
DataType=0x0005
AccessType=ro
DefaultValue=2
[1800sub1]
ParameterName=COB-ID
ObjectType=0x7
DataType=0x0007
AccessType=rw
DefaultValue=\$NODEID+0x180
[1800sub2]
ParameterName=Transmission type
ObjectType=0x7
DataType=0x0005
AccessType=rw
DefaultValue=1
[1A00]
ParameterName=Mapping 1
ObjectType=0x9
SubNumber=2
[1A00sub0]
ParameterName=Number of mapped objects
ObjectType=0x7
DataType=0x0005
AccessType=rw
DefaultValue=1
[1A00sub1]
ParameterName=Object 1
ObjectType=0x7
DataType=0x0007
AccessType=rw
DefaultValue=0x606C0010
[606C]
ParameterName=Velocity actual value
ObjectType=0x7
DataType=0x0003
AccessType=ro
DefaultValue=0
PDOMapping=1
$1
EDS
}
eds $'LowLimit=-3000\nHighLimit=3000' >limited.eds
eds "" >plain.eds
for name in limited plain; do
    venv/bin/canconvert --edsNode=5 "$name.eds" "$name.dbc" >"$name.txt" 2>&1
    # the signal of the PDO, not that of the SDO, which is multiplexed
    grep -oE 'SG_ Velocity_actual_value : .*\]' "$name.dbc" | tail -1 >"$name.signal"
done
echo "canmatrix $(venv/bin/python -c 'import importlib.metadata as m; print(m.version("canmatrix"))'):" \
    "with limits \"$(cat limited.signal)\", without \"$(cat plain.signal)\""
grep -qF '(1,-3000) [-3000|3000]' limited.signal && grep -qF '(1,0)' plain.signal
