#!/bin/busybox sh
# The guest's first program: modules, the host's file system under an overlay, the command.
# Everything is told by the share "job": see machine.py.
/bin/busybox mkdir -p /proc /sys /dev /job /host /upper /root
/bin/busybox mount -t proc proc /proc
/bin/busybox mount -t sysfs sys /sys
/bin/busybox mount -t devtmpfs dev /dev
b=/bin/busybox

for module in /modules/*; do
    options=
    case "$module" in *can-gw*) options=max_hops=4 ;; esac  # from one namespace to another
    $b insmod "$module" $options || echo "insmod $module failed"
done

nine() { $b mount -t 9p -o "trans=virtio,version=9p2000.L,msize=1048576,$3" "$1" "$2"; }
nine job /job cache=none || $b poweroff -f
nine host /host ro,cache=loose || $b poweroff -f

# Whatever the guest writes goes to memory, and is gone with it.
$b mount -t tmpfs -o mode=755 tmpfs /upper
$b mkdir /upper/top /upper/work
$b mount -t overlay -o lowerdir=/host,upperdir=/upper/top,workdir=/upper/work overlay /root \
    || $b poweroff -f
for folder in run dev/shm; do
    [ "$folder" = dev/shm ] && $b mount --move /dev /root/dev
    $b mkdir -p "/root/$folder"
    $b mount -t tmpfs -o mode=1777 tmpfs "/root/$folder"
done
$b mkdir -p /root/dev/pts /root/run/dbw-job
$b mount -t devpts devpts /root/dev/pts
$b mount --move /proc /root/proc
$b mount --move /sys /root/sys
$b mount --bind /job /root/run/dbw-job
$b hostname can-by-wire

number=0
while IFS= read -r folder; do  # folders of the host that the command may write to
    $b mkdir -p "/root$folder"
    nine "write$number" "/root$folder" cache=none || $b poweroff -f
    number=$((number + 1))
done < /job/writable

$b chroot /root /bin/sh /run/dbw-job/start.sh
$b sync
$b poweroff -f
