//! Image files in and out: OpenEXR, Radiance HDR, PNG.
