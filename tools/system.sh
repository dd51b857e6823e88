#!/bin/sh
# What pip cannot install: OpenGL without a display (EGL), and Debian's separately packaged `venv`.
# Installs what is absent with apt-get where that is permitted, and says in one line what to install where it is not.
# NO_APT=1 forbids it.
# Usage: tools/system.sh PYTHON [node] [chromium] [firefox] [xvfb]

python=$1
shift
missing=""
if [ "$(uname)" = Linux ]; then
    libraries=$(PATH="$PATH:/sbin:/usr/sbin" ldconfig -p 2>/dev/null)
    case $libraries in *libEGL.so.1*) ;; *) missing="$missing libegl1" ;; esac
    case $libraries in *libGL.so.1*) ;; *) missing="$missing libgl1" ;; esac
    [ -n "$missing" ] && missing="$missing libgl1-mesa-dri"
fi
"$python" -c "import ensurepip" 2>/dev/null || missing="$missing $(basename "$("$python" -c \
    'import sys; print("python{}.{}".format(*sys.version_info))')")-venv"
case $* in *node*) command -v npm >/dev/null || missing="$missing nodejs npm" ;; esac
case $* in *chromium*) [ -x "${CHROMIUM:-/usr/bin/chromium}" ] || missing="$missing chromium" ;; esac
case $* in *firefox*)
    [ -x /usr/bin/firefox-esr ] || missing="$missing firefox-esr"
    command -v xvfb-run >/dev/null || missing="$missing xvfb"
    command -v xauth >/dev/null || missing="$missing xauth" ;;
esac
case $* in *xvfb*)
    command -v Xvfb >/dev/null || missing="$missing xvfb"
    command -v xdotool >/dev/null || missing="$missing xdotool" ;;
esac
[ -z "$missing" ] && exit 0

if [ "$(id -u)" = 0 ]; then as_root=""; else as_root="sudo -n"; fi
if [ -z "$NO_APT" ] && command -v apt-get >/dev/null && $as_root true 2>/dev/null; then
    echo "installing with apt-get:$missing"
    export DEBIAN_FRONTEND=noninteractive
    $as_root apt-get update -qq && $as_root apt-get install -qq -y --no-install-recommends $missing >/dev/null && exit 0
fi
echo "please install these system packages (Debian and Ubuntu names):$missing" >&2
