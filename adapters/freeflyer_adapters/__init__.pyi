from .device import Device as Device
from .device_component import DeviceComponent as DeviceComponent
from .facility.settings import FacilitySettings as FacilitySettings
from .facility.virtual_device import VirtualDevice as VirtualDevice
from .recording.frame import read_recording as read_recording
